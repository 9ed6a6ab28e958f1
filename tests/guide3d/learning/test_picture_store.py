"""The store of prepared pictures, shared by processes that make it at the same time."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from guide3d.learning.picture_store import PictureStore, Preprocessing
from tests.guide3d.learning.drawn_data import draw


@pytest.mark.parametrize("overtaken_at", [1, 2])
def test_a_store_made_by_two_processes_at_once_never_gives_an_empty_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overtaken_at: int
) -> None:
    data, preprocessing = draw(tmp_path / "drawn"), Preprocessing(32, 128)
    others: list[PictureStore] = []
    targets: list[Path] = []
    replace = os.replace

    def overtaken(source: Path, target: Path) -> None:
        """Lets another process make its store just before one of this one's files appears."""
        targets.append(target)
        if len(targets) != overtaken_at:
            replace(source, target)
            return
        aside = target.with_name("aside")
        replace(source, aside)  # two processes name their temporary files differently
        with monkeypatch.context() as undone:
            undone.setattr(os, "replace", replace)
            others.append(PictureStore(data.frames, "a", preprocessing, tmp_path / "pictures"))
        replace(aside, target)

    monkeypatch.setattr(os, "replace", overtaken)
    store = PictureStore(data.frames, "a", preprocessing, tmp_path / "pictures")
    indices = np.arange(len(data.frames))
    expected = np.stack([preprocessing(frame.image("a")) for frame in data.frames])
    for one in [*others, store]:
        assert np.array_equal(one.pictures(indices), expected)
