"""Progress of jobs beside each other: a bar on a terminal, a line now and then in a log."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tqdm import tqdm

_LOGGER = logging.getLogger(__name__)
_SECONDS_BETWEEN_LINES = 20.0
_SHOWN_IN_A_LINE = 4


@dataclass
class JobState:
    """How far one job is; its status is "waiting", "running", "done" or "failed"."""

    key: str
    status: str = "waiting"
    fraction: float = 0.0
    text: str = ""

    def finish(self) -> None:
        """It is done."""
        self.status, self.fraction = "done", 1.0


class JobDisplay:
    """Shows the jobs of a stage."""

    def __init__(self, label: str, keys: Sequence[str], todo: Sequence[str]) -> None:
        """Shows jobs by their keys; those that are not to do were done by an earlier, interrupted run."""
        self.label, self.states = label, {key: JobState(key) for key in keys}
        for key in set(keys).difference(todo):
            self.states[key].finish()
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

    def line(self) -> str:
        """Words the progress: ``trainings 3/12, 2 running: a 45 % (success 0.8), b 3 %; 120 s``."""
        running = [state for state in self.states.values() if state.status == "running"]
        job_texts = ", ".join(
            f"{state.key} {100 * state.fraction:.0f} %" + (f" ({state.text})" if state.text else "")
            for state in running[:_SHOWN_IN_A_LINE]
        )
        more = ", …" if len(running) > _SHOWN_IN_A_LINE else ""
        failed = self._count("failed")
        return (
            f"{self.label} {self._count('done')}/{len(self.states)}"
            + (f", {failed} failed" if failed else "")
            + (f", {len(running)} running: {job_texts}{more}" if running else "")
            + f"; {time.monotonic() - self._started:.0f} s"
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
