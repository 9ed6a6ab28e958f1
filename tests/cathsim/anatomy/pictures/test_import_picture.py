"""Pictures of imports: which notes are doubts, which vessels they name, and the picture that the last note names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cathsim.anatomy import Phantom
from cathsim.anatomy.mesh.report import ImportReport
from cathsim.anatomy.pictures.import_picture import doubts, draw_import, vessels_named, with_picture_of_doubts

FACTS = ("united from 3 parts", "distances every 0.5 mm: its vessels are a child's", "target lcca lies 9 mm up")
DOUBTS = ("lcca is cut off by the volume's edge", "left and right cannot be told by its shape")


def imported(phantom: Phantom, notes: tuple[str, ...]) -> Phantom:
    rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    report = ImportReport(
        "arch.stl", "mm", "given", 100, "closed lumen", 4, rows, (0.0, 0.0, 0.0), 1e-3, True, {}, {}, notes
    )
    return replace(phantom, imported=report)


def test_doubts_are_all_notes_but_those_of_what_was_done() -> None:
    assert doubts((*FACTS, *DOUBTS)) == DOUBTS
    assert doubts(()) == ()


@pytest.mark.parametrize(
    ("note", "named"),
    [
        (DOUBTS[0], ("lcca",)),
        ("the first branch of the arch looks like the common trunk of BCA and LCCA", ("bca", "lcca")),
        ("the aorta's lower end is cut off by the volume's edge", ("aorta",)),
        ("lcca leaves the aorta late", ("lcca",)),
        (DOUBTS[1], ()),
    ],
)
def test_a_doubt_belongs_to_the_vessels_that_it_names(note: str, named: tuple[str, ...]) -> None:
    assert vessels_named(note, ("aorta", "bca", "lcca", "lsa")) == named


def test_the_picture_names_vessels_and_numbers_doubts(phantom: Phantom, tmp_path: Path) -> None:
    figure = draw_import(imported(phantom, (*FACTS, *DOUBTS)), tmp_path / "new" / "picture.png")
    assert (tmp_path / "new" / "picture.png").stat().st_size > 50_000
    words = {text.get_text() for text in figure.axes[0].texts}
    assert {"lcca (1)", "bca", "lsa", "aorta"} <= words
    _, listed = figure.texts  # after the title
    assert listed.get_text() == f"1. {DOUBTS[0]}\n2. {DOUBTS[1]}"
    assert "arch.stl: unit mm (given)" in figure.get_suptitle()


def test_the_last_note_of_a_doubtful_import_names_its_picture(
    phantom: Phantom, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sure = imported(phantom, FACTS)
    assert with_picture_of_doubts(sure, tmp_path / "sure.png") is sure
    assert not (tmp_path / "sure.png").exists()
    unsure = with_picture_of_doubts(imported(phantom, (*FACTS, *DOUBTS)), tmp_path / "unsure.png")
    assert unsure.imported is not None
    picture = f"what is unsure is marked in the picture {tmp_path / 'unsure.png'}"
    assert unsure.imported.notes == (*DOUBTS, *FACTS, picture)
    assert doubts(unsure.imported.notes) == DOUBTS
    (tmp_path / "file").write_text("")
    assert with_picture_of_doubts(imported(phantom, DOUBTS), tmp_path / "file" / "x.png").imported.notes == DOUBTS
    assert "cannot be written" in caplog.text
