"""Progress: items are passed on, and the rest is estimated by what this run did."""

from __future__ import annotations

from pipeline.store.run_folder import progress, progress_line


def test_progress_passes_everything_on_and_estimates_the_rest() -> None:
    assert list(progress([3, 1, 2], "numbers")) == [3, 1, 2]
    assert progress_line("phantoms", 2, 6, 8.0, 2) == "phantoms 2/6, 8 s, about 16 s left"
    assert progress_line("phantoms", 4, 6, 4.0, 1) == "phantoms 4/6, 4 s, about 8 s left"  # three were done before
    assert progress_line("phantoms", 6, 6, 9.0, 3) == "phantoms 6/6, 9 s"
