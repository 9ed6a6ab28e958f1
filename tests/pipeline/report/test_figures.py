"""Figures of the page: those beyond its room lie beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.report.figures import gather_figures
from pipeline.report.results import Figure, write_figures


def test_figures_beyond_the_page_s_room_lie_beside_it(tmp_path: Path) -> None:
    stage, report = tmp_path / "learning", tmp_path / "report"
    for name, width in (("a", 1300), ("b", 300)):
        stage.mkdir(exist_ok=True)
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (40, width), dtype=np.uint8)).save(
            stage / f"{name}.png"
        )
    write_figures(stage, [Figure("A", "", "a.png"), Figure("B", "", "b.png")])
    wide, narrow = gather_figures("learning", stage, report, embed_limit=10**9, room=30_000)
    assert (wide.is_wide, narrow.is_wide) == (True, False)
    assert wide.source == "figures/learning/a.png"
    assert (report / wide.source).is_file()
    assert wide.embedded_bytes == 0
    assert narrow.embedded_bytes == len(narrow.source) > 1000
