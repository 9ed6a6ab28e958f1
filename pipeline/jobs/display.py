"""Progress of jobs beside each other: bars on a terminal, a line now and then in a log, and when it will end."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any

_LOGGER = logging.getLogger(__name__)
_SECONDS_BETWEEN_LINES = 20.0
_SHOWN_IN_A_LINE = 4
_LEAST_FRACTION = 0.02  # of a job before its pace says anything


class JobState:
    """How far one job is."""

    def __init__(self, key: str, weight: float = 1.0, *, done: bool = False) -> None:
        """Args:
        weight: how long it takes beside the others; 0: not known, as it may be left out.
        done: by an earlier, interrupted run.
        """
        self.key, self.weight = key, weight
        self.status = "done" if done else "waiting"
        self.fraction, self.text = float(done), ""
        self._started, self._first, self._spent_s = 0.0, 0.0, 0.0
        self._seen = False

    def start(self) -> None:
        """Its process has started."""
        self.status, self._started = "running", time.monotonic()

    def wait(self) -> None:
        """It has to start once more, and goes on from its checkpoint."""
        self.status, self._seen = "waiting", False

    def update(self, fraction: float, text: str) -> None:
        """Takes the job's progress.

        Args:
            fraction: 0 to 1; the first one counts as what an earlier run had done already.
        """
        if not self._seen:
            self._seen, self._first = True, fraction
        self.fraction, self.text = fraction, text

    def finish(self) -> None:
        """It is done."""
        self._spent_s = time.monotonic() - self._started
        self.status, self.fraction = "done", 1.0

    def leave_out(self) -> None:
        """It is done without having run."""
        self.status, self.fraction, self.weight = "done", 1.0, 0.0

    def fail(self) -> None:
        """It has failed, or never started because another has."""
        self.status = "failed"

    def total_s(self) -> float | None:
        """Seconds that all of it takes at the pace it has shown; None while that is unknown."""
        gained = self.fraction - self._first
        if self.status == "done" and self._spent_s:
            return self._spent_s / max(1.0 - self._first, _LEAST_FRACTION)
        if self.status == "running" and gained >= _LEAST_FRACTION:
            return (time.monotonic() - self._started) / gained
        return None


class JobDisplay:
    """Shows the jobs of a stage."""

    def __init__(self, label: str, states: Sequence[JobState], *, workers: int) -> None:
        """Args:
        workers: how many run beside each other.
        """
        self.label, self.states, self.workers = label, {state.key: state for state in states}, workers
        self._bars: list[Any] = []
        self._started = self._last_line = time.monotonic()
        self._last_done = self._count("done")

    def __enter__(self) -> JobDisplay:
        if sys.stderr.isatty():
            from tqdm import tqdm

            self._bars = [tqdm(total=len(self.states), desc=self.label, dynamic_ncols=True, leave=False)]
            rows = min(self.workers, len(self.states))
            form = "{desc} {percentage:3.0f}%|{bar}|{postfix}"
            self._bars += [
                tqdm(total=1.0, position=row + 1, bar_format=form, dynamic_ncols=True, leave=False)
                for row in range(rows)
            ]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for bar in self._bars:
            bar.close()
        self._bars = []

    def _count(self, *statuses: str) -> int:
        return sum(state.status in statuses for state in self.states.values())

    def remaining_s(self) -> float | None:
        """Seconds until every job is done, by the pace of those that have shown one; None while none has."""
        known = [(state.total_s(), state.weight) for state in self.states.values()]
        paced = [(total, weight) for total, weight in known if total is not None and weight]
        if not paced:
            return None
        per_weight = sum(total for total, _ in paced) / max(sum(weight for _, weight in paced), 1e-9)
        left = [
            (1.0 - state.fraction) * (state.total_s() or per_weight * state.weight)
            for state in self.states.values()
            if state.status in ("waiting", "running")
        ]
        # No job is shared by two processes: the longest one bounds the end.
        return max([sum(left) / self.workers, *left]) if left else 0.0

    def line(self) -> str:
        """Words the progress: ``trainings 3/12, 2 running: a 45 % (success 0.8), b 3 %; 120 s, about 300 s left``."""
        running = [state for state in self.states.values() if state.status == "running"]
        shown = ", ".join(
            f"{state.key} {100 * state.fraction:.0f} %" + (f" ({state.text})" if state.text else "")
            for state in running[:_SHOWN_IN_A_LINE]
        )
        more = ", …" if len(running) > _SHOWN_IN_A_LINE else ""
        failed = self._count("failed")
        left = self.remaining_s()
        return (
            f"{self.label} {self._count('done')}/{len(self.states)}"
            + (f", {failed} failed" if failed else "")
            + (f", {len(running)} running: {shown}{more}" if running else "")
            + f"; {time.monotonic() - self._started:.0f} s"
            + (f", about {left:.0f} s left" if left else "")
        )

    def show(self) -> None:
        """Brings the bars up to date, or logs a line when it is time or a job has ended."""
        if self._bars:
            self._draw()
            return
        now, done = time.monotonic(), self._count("done", "failed")
        if done != self._last_done or now - self._last_line >= _SECONDS_BETWEEN_LINES:
            self._last_line, self._last_done = now, done
            _LOGGER.info("%s", self.line())

    def _draw(self) -> None:
        overall, *rows = self._bars
        left = self.remaining_s()
        overall.n = self._count("done")
        overall.set_postfix_str("" if left is None else f"about {left:.0f} s left")
        running = [state for state in self.states.values() if state.status == "running"]
        for row, state in zip(rows, [*running, *[None] * len(rows)], strict=False):
            row.n = state.fraction if state else 0.0
            row.set_description_str(state.key if state else "", refresh=False)
            row.set_postfix_str(state.text if state else "")
