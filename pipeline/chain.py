"""Chains of stages, each in a process of its own: ``python -m pipeline.chain all -- budget=desk name=desk``.

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
from dataclasses import dataclass, field, fields
from types import FrameType
from typing import IO, Any

from enn.reinforcement.resources import available_bytes
from pipeline.jobs.engines.local import available_workers
from pipeline.jobs.machine import shared_machine
from pipeline.printing import say, written
from pipeline.stages import available_stages, load_stage, settings_of
from pipeline.store.interruption import stop_at_once_by_ctrl_c


@dataclass(frozen=True)
class Step:
    """A stage of a chain, and the seed that it runs with; None: that of the overrides."""

    stage: str
    seed: int | None = None

    def __str__(self) -> str:
        return self.stage if self.seed is None else f"{self.stage} with seed {self.seed}"


def steps_of(stages: Sequence[str], seeds: int) -> list[Step]:
    """What a chain runs, in order: repeated stages once for each of so many seeds."""
    if seeds == 1:
        return [Step(stage) for stage in stages]
    return [Step(stage, seed or None) for stage in stages for seed in range(seeds if load_stage(stage).repeated else 1)]


def waits_for(steps: Sequence[Step], place: int) -> list[int]:
    """Places of the earlier steps that must be done before a step may start: those of stages that it reads or uses."""
    stage = load_stage(steps[place].stage)
    return [
        k for k, earlier in enumerate(steps[:place]) if stage.gathers or earlier.stage in (*stage.reads, *stage.uses)
    ]


def steps_to_the_end(steps: Sequence[Step]) -> list[int]:
    """How many steps the longest chain has that begins with each: the step, one that waits for it, and so on."""
    count = [1] * len(steps)
    for place in reversed(range(len(steps))):
        for earlier in waits_for(steps, place):
            count[earlier] = max(count[earlier], count[place] + 1)
    return count


def after_inputs(stages: Sequence[str]) -> list[str]:
    """The stages and all that they read, directly or not, in order."""
    stage_names, todo = set[str](), list(stages)
    while todo:
        name = todo.pop()
        stage_names.add(name)
        todo += load_stage(name).reads
    return [name for name in available_stages() if name in stage_names]


def concerns(override: str, stage: str) -> bool:
    """Whether an override is for a stage: `stage.KEY` is for those that have the setting, `stage@NAME.KEY` for one."""
    group, _, key = override.lstrip("+~").partition("=")[0].partition(".")
    group, _, only = group.partition("@")
    if group != "stage" or not key:
        return True
    names = {item.name for item in fields(settings_of(stage))}
    return only in ("", stage) and key.partition(".")[0] in names


def words_of(step: Step, overrides: Sequence[str]) -> list[str]:
    """The words with which the pipeline runs a step."""
    own = [word.replace(f"stage@{step.stage}.", "stage.", 1) for word in overrides if concerns(word, step.stage)]
    return [f"stage={step.stage}", *own, *([] if step.seed is None else [f"seed={step.seed}"])]


def refused(steps: Sequence[Step], overrides: Sequence[str]) -> str:
    """Which step's settings would be refused when its turn comes, perhaps after hours, and why; "" if none's."""
    from pipeline.launch import refusal

    if len(steps) == 1 or any(word.startswith("-") for word in overrides):  # Hydra's options
        return ""
    stages = dict.fromkeys(step.stage for step in steps)  # further seeds change no setting
    return next((f"{stage}: {why}" for stage in stages if (why := refusal(words_of(Step(stage), overrides)))), "")


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
    """Runs the steps, so many beside each other, until one fails, whose exit code it gives: 128 + N after signal N."""
    machine = shared_machine(available_workers(), available_bytes() / _GB) if beside > 1 else contextlib.nullcontext()
    with machine, _Processes() as processes:
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
        progress = f"; {len(self._done)} done in {self._so_far()}" if self._done else ""
        say(f"== stage {self._started} of {len(self._steps)}: {step}{progress}")
        command = [sys.executable, "-m", "pipeline", *words_of(step, self._overrides)]
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
        """Starts a process; its lines are told with the name, and without one it has the terminal."""
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


_USAGE = """\
{command} [--seeds N] [--beside N] all|[--inputs] STAGE ... -- [OVERRIDE ...]

Runs all stages, or some, one after the other, and says how far it is.

  --inputs     the stages after those that they read
  --seeds N    stages whose figures depend on the seed run with seeds 0 to N - 1; the report shows means and intervals
  --beside N   up to N stages that do not need each other run at the same time and share cores, memory and GPUs

Overrides go to every stage, e.g. budget=desk name=desk engine=ray, stage.KEY=VALUE to those that have the setting, e.g.
stage.device=cuda, and stage@NAME.KEY=VALUE to one. It ends with the first stage that fails; the same command goes on
from there.
"""
_EXIT_USAGE = 2
_ALL, _INPUTS, _SEEDS, _BESIDE = "all", "--inputs", "--seeds", "--beside"
_MOST_SEEDS = 20  # that pipeline.seeds has ranges for
_MOST_BESIDE = 64


def main(arguments: list[str]) -> int:
    """Runs the command line; gives 0, or the exit code of the stage that failed."""
    if "--help" in arguments or "-h" in arguments:
        say(_USAGE.format(command=written("chain")))
        return 0
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    stages, overrides = arguments[:cut], arguments[cut + 1 :]
    try:
        seeds, beside = _taken(stages, _SEEDS, _MOST_SEEDS), _taken(stages, _BESIDE, _MOST_BESIDE)
        if seeds > 1 and any(word.startswith("seed=") for word in overrides):
            raise ValueError(f"{_SEEDS} counts from seed 0 on: leave seed=… out, or {_SEEDS}")
    except ValueError as error:
        say(str(error), error=True)
        return _EXIT_USAGE
    with_inputs = _INPUTS in stages
    stages = [name for name in stages if name != _INPUTS]
    stages = list(available_stages()) if stages == [_ALL] else stages
    unknown = [name for name in stages if name not in available_stages()]
    if unknown or not stages:
        problem = f"unknown stage {unknown[0]!r}" if unknown else "no stage is named"
        if unknown and (setting := next((word for word in stages if "=" in word), None)):
            say(f"{setting} is no stage: settings stand behind --, after the stages", error=True)
            return _EXIT_USAGE
        say(f"{problem}: choose from {_ALL}, {', '.join(available_stages())}", error=True)
        return _EXIT_USAGE
    if with_inputs:
        stages = after_inputs(stages)
    foreign = [word for word in overrides if not any(concerns(word, stage) for stage in stages)]
    if foreign:
        say(f"no stage of the chain has the setting {foreign[0]!r}: name its stage, or leave it out", error=True)
        return _EXIT_USAGE
    steps = steps_of(stages, seeds)
    if problem := refused(steps, overrides):
        say(problem, error=True)
        return _EXIT_USAGE
    return run(steps, overrides, beside)


def _taken(words: list[str], option: str, largest: int) -> int:
    """Takes an option and its number out of the words before the overrides; 1 where it is not there."""
    if option not in words:
        return 1
    place = words.index(option)
    number = words[place + 1] if place + 1 < len(words) else ""
    del words[place : place + 2]
    if not number.isdecimal() or not 1 <= int(number) <= largest:
        raise ValueError(f"{option} needs a whole number from 1 to {largest}, got {number or 'nothing'!r}")
    return int(number)


if __name__ == "__main__":
    stop_at_once_by_ctrl_c()
    sys.exit(main(sys.argv[1:]))
