"""Pictures of phantoms and of imports, whose notes say what is unsure."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Phantom
from cathsim.anatomy.mesh.report import ImportReport
from cathsim.anatomy.pictures.import_picture import doubts, draw_import, with_picture_of_doubts
from cathsim.anatomy.pictures.phantom_picture import VIEWS, draw_phantom

FACTS = ("united from 3 parts", "distances every 0.5 mm: its vessels are a child's", "target lcca lies 9 mm up")
DOUBTS = ("lcca is cut off by the volume's edge", "left and right cannot be told by its shape")


def imported(phantom: Phantom, notes: tuple[str, ...]) -> Phantom:
    rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    report = ImportReport(
        "arch.stl", "mm", "given", 100, "closed lumen", 4, rows, (0.0, 0.0, 0.0), 1e-3, True, {}, {}, notes
    )
    return replace(phantom, imported=report)


def test_the_picture_names_vessels_and_numbers_doubts(phantom: Phantom, tmp_path: Path) -> None:
    figure = draw_import(imported(phantom, (*FACTS, *DOUBTS)), tmp_path / "new" / "picture.png")
    assert (tmp_path / "new" / "picture.png").stat().st_size > 50_000
    words = {text.get_text() for text in figure.axes[0].texts}
    assert {"lcca (1)", "bca", "lsa", "aorta"} <= words
    assert f"1. {DOUBTS[0]}" in figure.texts[1].get_text()  # after the title


def test_the_last_note_of_a_doubtful_import_names_its_picture(
    phantom: Phantom, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sure = imported(phantom, FACTS)
    assert with_picture_of_doubts(sure, tmp_path / "sure.png") is sure
    assert not (tmp_path / "sure.png").exists()
    unsure = with_picture_of_doubts(imported(phantom, (*FACTS, *DOUBTS)), tmp_path / "unsure.png")
    *notes, picture = unsure.imported.notes
    assert notes == [*DOUBTS, *FACTS]
    assert picture.endswith(str(tmp_path / "unsure.png"))
    assert doubts(unsure.imported.notes) == DOUBTS
    (tmp_path / "file").write_text("")
    assert with_picture_of_doubts(imported(phantom, DOUBTS), tmp_path / "file" / "x.png").imported.notes == DOUBTS
    assert "cannot be written" in caplog.text


def test_the_picture_shows_the_vessel_from_every_side(phantom, tmp_path):
    path = tmp_path / "type_1.png"
    figure = draw_phantom(phantom, path, pixel=2e-3)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert len(figure.axes) == len(VIEWS)
    seen = [np.any(np.asarray(axes.images[0].get_array()) < 0.99, axis=-1) for axes in figure.axes]
    for axes in figure.axes:
        assert set(phantom.targets) <= {text.get_text() for text in axes.texts}
    # From the front the shadow is that of the lumen: its area in the grid, seen along y.
    shadow = np.count_nonzero((phantom.grid.values > 0).any(axis=1)) * phantom.grid.spacing**2
    assert seen[0].sum() * 4e-6 / shadow == pytest.approx(1, abs=0.05)
    assert seen[0].mean() != seen[2].mean()
