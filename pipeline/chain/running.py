"""Runs the steps of a chain, each in a process of its own, as if called by itself.

One after the other, a stage has the terminal, with its own progress. Beside each other, stages that do not need one
another share the machine (`pipeline.jobs.machine`), and each line begins with the step's name.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import FrameType
from typing import IO, Any

from enn.reinforcement.free_memory import available_bytes
from pipeline.chain.steps import Step, concerns, steps_to_the_end, waits_for
from pipeline.jobs.engines.local import available_workers
from pipeline.jobs.machine import shared_machine
from pipeline.printing import say

_SECONDS_BETWEEN_LOOKS = 0.1
_GB = 1e9


@dataclass
class _Running:
    """A step under way."""

    place: int
    process: subprocess.Popen[str]
    began: float = field(default_factory=time.monotonic)
    readers: list[threading.Thread] = field(default_factory=list)


def run(steps: Sequence[Step], overrides: Sequence[str], beside: int = 1) -> int:
    """Runs the steps; it ends with the first that fails, and asks those beside that one to stop.

    Args:
        beside: steps at the same time.

    Returns:
        0, or the exit code of the step that failed, 128 + N where signal N ended it.
    """
    room = shared_machine(available_workers(), available_bytes() / _GB) if beside > 1 else contextlib.nullcontext()
    with room, _Processes() as processes:
        return _Chain(steps, overrides, beside, processes).run()


class _Chain:
    """Which steps are done, which are under way, and which wait."""

    def __init__(
        self, steps: Sequence[Step], overrides: Sequence[str], beside: int, processes: _Processes
    ) -> None:  # fmt: skip
        self._steps, self._overrides, self._beside, self._processes = steps, overrides, beside, processes
        self._waiting = list(range(len(steps)))
        # one after the other they are in order anyway, and a stage that is missing says so itself
        self._needs = [waits_for(steps, place) if beside > 1 else [] for place in self._waiting]
        if beside > 1:  # what the most waits for comes first, or the last stages would run alone
            count = steps_to_the_end(steps)
            self._waiting.sort(key=lambda place: -count[place])
        self._done: set[int] = set()
        self._spent: dict[str, float] = {}  # minutes of each stage
        self._started, self._began = 0, time.monotonic()

    def run(self) -> int:
        code = 0
        under_way = self._processes.under_way
        while True:
            while not code and (place := self._next()) is not None:
                self._start(place)
            code = code or self._processes.code
            if not under_way:
                break
            for running in [one for one in under_way if one.process.poll() is not None]:
                failed = self._end(running)
                if failed and not code:  # those that are stopped fail, too
                    code = failed
                    self._processes.stop_all()
            time.sleep(_SECONDS_BETWEEN_LOOKS)
        if code:
            return code
        longest = sorted(self._spent, key=lambda name: -self._spent[name])[:3]
        parts = ", ".join(f"{name} {worded(self._spent[name])}" for name in longest)
        say(f"== all {len(self._steps)} stages in {self._so_far()}: most of it {parts}")
        return 0

    def _so_far(self) -> str:
        return worded((time.monotonic() - self._began) / 60)

    def _next(self) -> int | None:
        """The first step that may start now."""
        if self._processes.code or len(self._processes.under_way) >= self._beside:
            return None
        return next((place for place in self._waiting if self._done.issuperset(self._needs[place])), None)

    def _start(self, place: int) -> None:
        step = self._steps[place]
        self._started += 1
        told = f"; {len(self._done)} done in {self._so_far()}" if self._done else ""
        say(f"== stage {self._started} of {len(self._steps)}: {step}{told}")
        own = [w.replace(f"stage@{step.stage}.", "stage.", 1) for w in self._overrides if concerns(w, step.stage)]
        own += [] if step.seed is None else [f"seed={step.seed}"]
        command = [sys.executable, "-m", "pipeline", f"stage={step.stage}", *own]
        self._waiting.remove(place)
        self._processes.start(place, command, name=str(step) if self._beside > 1 else None)

    def _end(self, running: _Running) -> int:
        """A step's process has ended; 0, or its exit code."""
        for reader in running.readers:
            reader.join()
        self._processes.under_way.remove(running)
        code = running.process.returncode
        if code:
            return int(code) if code > 0 else 128 - int(code)
        self._done.add(running.place)
        stage = self._steps[running.place].stage
        self._spent[stage] = self._spent.get(stage, 0.0) + (time.monotonic() - running.began) / 60
        return 0


class _Processes:
    """The processes under way: leaves Ctrl-C and SIGTERM to them, and lets no other start afterwards."""

    def __init__(self) -> None:
        self.under_way: list[_Running] = []
        self.code = 0  # 128 + N after signal N
        self._former: dict[int, Any] = {}

    def __enter__(self) -> _Processes:
        for number in (signal.SIGINT, signal.SIGTERM):
            former = signal.getsignal(number)
            if former is not signal.SIG_IGN:  # as nohup and background jobs ask for; a stage inherits that, no handler
                self._former[number] = former
                signal.signal(number, self._receive)
        return self

    def __exit__(self, *unused: object) -> None:
        for number, former in self._former.items():
            signal.signal(number, former)

    def start(self, place: int, command: Sequence[str], *, name: str | None) -> None:
        """Starts a process.

        Args:
            name: that its lines are told with; None: it has the terminal.
        """
        if name is None:
            process = subprocess.Popen(command, text=True)
            self.under_way.append(_Running(place, process))
        else:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                errors="replace",
            )  # fmt: skip
            running = _Running(place, process)
            self.under_way.append(running)
            for stream, error in ((process.stdout, False), (process.stderr, True)):
                reader = threading.Thread(target=_tell, args=(stream, name, error), daemon=True)
                reader.start()
                running.readers.append(reader)
        if self.code == 128 + signal.SIGTERM:  # it came between the look and the start
            process.terminate()

    def stop_all(self) -> None:
        """Asks all to write their checkpoints and leave."""
        for running in self.under_way:
            running.process.terminate()

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self.code = self.code or 128 + number  # a terminal's Ctrl-C reaches the stages, too
        if number == signal.SIGTERM:
            self.stop_all()


def _tell(lines: IO[str], name: str, error: bool) -> None:
    for line in lines:
        say(f"{name} | {line}", error=error)


def worded(minutes: float) -> str:
    """For example ``40 s``, ``12 min`` or ``2 h 05 min``."""
    if minutes < 1:
        return f"{60 * minutes:.0f} s"
    hours, rest = divmod(round(minutes), 60)
    return f"{hours} h {rest:02d} min" if hours else f"{rest} min"
