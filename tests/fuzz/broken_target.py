"""A target that fails in every way there is, to see that the runner finds it."""

from __future__ import annotations

import os
import time

from tests.fuzz.target import Target, refused


class BrokenTarget(Target):
    """Seed 0 is fine; 1 raises, 2 dies, 3 hangs, 4 refuses in two lines."""

    name = "broken"
    seconds = 0.5

    def run(self, seed: int) -> None:
        if seed == 1:
            raise KeyError("nothing of that name")
        if seed == 2:
            os._exit(1)
        if seed == 3:
            time.sleep(60)
        if seed == 4:
            refused(ValueError("two\nlines"))
        self.counts["refused"] += 1
