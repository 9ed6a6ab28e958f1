"""Figures of the page: those beyond its room lie beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.report.figures import gather_figures
from pipeline.tables import Figure, write_figures


def test_figures_beyond_the_page_s_room_lie_beside_it(tmp_path: Path) -> None:
    stage, report = tmp_path / "learning", tmp_path / "report"
    for name, width in (("a", 1900), ("b", 300)):
        stage.mkdir(exist_ok=True)
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (40, width), dtype=np.uint8)).save(
            stage / f"{name}.png"
        )
    write_figures(stage, [Figure("A", "", "a.png"), Figure("B", "", "b.png")])
    wide, narrow = gather_figures("learning", stage, report, embed_limit=10**9, room=30_000)
    assert (wide.is_wide, narrow.is_wide) == (True, False)
    assert (wide.shown_size, narrow.shown_size) == ((950, 20), (150, 20))  # two dots of the picture a pixel
    assert wide.source == "figures/learning/a.png"
    assert (report / wide.source).is_file()
    assert wide.embedded_bytes == 0
    assert narrow.embedded_bytes == len(narrow.source) > 1000


def test_keys_are_worded_and_long_captions_have_a_folded_rest(tmp_path: Path) -> None:
    Image.new("L", (70, 40)).save(tmp_path / "000.gif")
    write_figures(tmp_path, [Figure("type_1/bca: episode 0", f"First. {'Rest. ' * 40}", "000.gif", stage="enn")])
    (film,) = gather_figures("expert@seed=1", tmp_path, tmp_path, embed_limit=10**9)
    assert (film.title, film.stage, film.is_film, film.shown_size) == ("Type I, BCA: episode 0", "enn", True, (70, 40))
    assert film.caption_parts[0] == "First."
    assert film.caption_parts[1].startswith("Rest.")
