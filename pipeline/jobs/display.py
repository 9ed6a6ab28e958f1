"""Progress of jobs beside each other: a bar on a terminal, a line now and then in a log, and when it will end."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Sequence
from typing import Any

from tqdm import tqdm

_LOGGER = logging.getLogger(__name__)
_SECONDS_BETWEEN_LINES = 20.0
_SHOWN_IN_A_LINE = 4
_LEAST_FRACTION = 0.02  # of a job before its pace says anything


class JobState:
    """How far one job is; its status is "waiting", "running", "done" or "failed"."""

    def __init__(self, key: str, *, done: bool = False) -> None:
        """Done: by an earlier, interrupted run."""
        self.key, self.status = key, "done" if done else "waiting"
        self.fraction, self.text = float(done), ""
        self._first: float | None = None  # fraction that an earlier run had done already
        self._started = self._spent_s = 0.0

    def start(self) -> None:
        """Its process has started, maybe not for the first time."""
        self.status, self._started, self._first = "running", time.monotonic(), None

    def update(self, fraction: float, text: str) -> None:
        """Takes the job's progress, 0 to 1."""
        self._first = fraction if self._first is None else self._first
        self.fraction, self.text = fraction, text

    def finish(self) -> None:
        """It is done."""
        self.status, self.fraction = "done", 1.0
        self._spent_s = time.monotonic() - self._started

    def total_s(self) -> float | None:
        """Seconds that all of it takes at the pace it has shown; None while that is unknown."""
        first = self._first or 0.0
        if self.status == "done" and self._spent_s:
            return self._spent_s / max(1.0 - first, _LEAST_FRACTION)
        if self.status == "running" and self.fraction - first >= _LEAST_FRACTION:
            return (time.monotonic() - self._started) / (self.fraction - first)
        return None


class JobDisplay:
    """Shows the jobs of a stage."""

    def __init__(self, label: str, keys: Sequence[str], todo: Sequence[str]) -> None:
        """Shows jobs by their keys; those that are not to do were done by an earlier, interrupted run."""
        self.label, self.states = label, {key: JobState(key, done=key not in todo) for key in keys}
        self._bar: Any = None
        self._started = self._last_line = time.monotonic()
        self._last_done = self._count("done")

    def __enter__(self) -> JobDisplay:
        if sys.stderr.isatty():
            form = "{percentage:3.0f}%|{bar:20}| {desc}"
            self._bar = tqdm(total=float(len(self.states)), bar_format=form, dynamic_ncols=True, leave=False)
        return self

    def __exit__(self, *unused: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def _count(self, *statuses: str) -> int:
        return sum(state.status in statuses for state in self.states.values())

    def remaining_s(self) -> float | None:
        """Seconds until every job is done, by the mean of those that have shown a pace; None while none has."""
        paced = [total for state in self.states.values() if (total := state.total_s()) is not None]
        if not paced:
            return None
        mean = sum(paced) / len(paced)
        left = [
            (1.0 - state.fraction) * (state.total_s() or mean)
            for state in self.states.values()
            if state.status in ("waiting", "running")
        ]
        # As many jobs as now go on beside each other; no job is shared by two processes, so the longest bounds the end.
        return max([sum(left) / max(self._count("running"), 1), *left]) if left else 0.0

    def line(self) -> str:
        """Words the progress: ``trainings 3/12, 2 running: a 45 % (success 0.8), b 3 %; 120 s, about 300 s left``."""
        running = [state for state in self.states.values() if state.status == "running"]
        job_texts = ", ".join(
            f"{state.key} {100 * state.fraction:.0f} %" + (f" ({state.text})" if state.text else "")
            for state in running[:_SHOWN_IN_A_LINE]
        )
        more = ", …" if len(running) > _SHOWN_IN_A_LINE else ""
        failed = self._count("failed")
        left = self.remaining_s()
        return (
            f"{self.label} {self._count('done')}/{len(self.states)}"
            + (f", {failed} failed" if failed else "")
            + (f", {len(running)} running: {job_texts}{more}" if running else "")
            + f"; {time.monotonic() - self._started:.0f} s"
            + (f", about {left:.0f} s left" if left else "")
        )

    def show(self) -> None:
        """Brings the bar up to date, or logs a line when it is time or a job has ended."""
        now, done = time.monotonic(), self._count("done", "failed")
        if self._bar is not None:
            self._bar.n = sum(state.fraction for state in self.states.values())
            self._bar.set_description_str(self.line())
        elif done != self._last_done or now - self._last_line >= _SECONDS_BETWEEN_LINES:
            self._last_line, self._last_done = now, done
            _LOGGER.info("%s", self.line())
