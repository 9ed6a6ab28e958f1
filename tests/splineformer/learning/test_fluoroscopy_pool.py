"""Pool of random images: what they show is counted, kept pictures are read again, and others are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.learning.fluoroscopy_pool import NONE, ONE, SEVERAL, curve_of, draw_pool

SMALL = FluoroscopySettings(image_px=128, clutter=1e-6, no_wire=0.3, two_devices=0.6)


def quarter(image: np.ndarray) -> np.ndarray:
    """Every fourth pixel."""
    return image[::4, ::4]


def test_kept_pictures_are_read_again(tmp_path: Path) -> None:
    calls: list[int] = []

    def picture(image: np.ndarray) -> np.ndarray:
        calls.append(len(image))
        return quarter(image)

    images = RandomFluoroscopy(SMALL, seed=4)
    pool = draw_pool(images, range(3, 63), picture, "quarters", tmp_path)
    drawn = len(calls)
    assert drawn == len(pool) <= 60
    assert pool.pictures.shape == (len(pool), 32, 32)
    again = draw_pool(images, range(3, 63), picture, "quarters", tmp_path)
    assert len(calls) == drawn
    for name in ("pictures", "curves", "wires"):
        assert np.array_equal(getattr(pool, name), getattr(again, name), equal_nan=name == "curves")
    assert set(pool.wires) == {NONE, ONE, SEVERAL}
    assert (np.isnan(pool.curves).all(axis=(1, 2)) == (pool.wires == NONE)).all()
    with pytest.raises(ValueError, match="another seed, source or settings"):
        draw_pool(RandomFluoroscopy(SMALL, seed=5), range(3, 63), picture, "quarters", tmp_path)
    file = next(tmp_path.glob("pool_*.npz"))
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(ValueError, match="is damaged"):
        draw_pool(images, range(3, 63), picture, "quarters", tmp_path)


def test_parts_of_which_nothing_is_kept_are_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    images = RandomFluoroscopy(SMALL, seed=4)
    monkeypatch.setattr("splineformer.learning.fluoroscopy_pool._PART", 1)
    few = draw_pool(images, range(3, 63), quarter, "quarters", tmp_path)
    again = draw_pool(images, range(3, 63), quarter, "quarters", tmp_path)
    assert 0 < len(few) == len(again) < 60
    left_out = next(k for k in range(3, 63) if _left_out(images, k))
    with pytest.raises(ValueError, match="none of 1 random images could be used: draw more"):
        draw_pool(images, range(left_out, left_out + 1), quarter, "quarters")


def _left_out(images: RandomFluoroscopy, index: int) -> bool:
    wires, curve = curve_of(images.image(index))
    return wires != NONE and curve is None


def test_a_curve_begins_at_its_tip() -> None:
    images = RandomFluoroscopy(SMALL, seed=1)
    for index in range(30):
        drawn = images.image(index)
        wires, curve = curve_of(drawn)
        assert wires in (NONE, ONE, SEVERAL)
        if curve is not None:
            tip = curve[0] * 128 - 0.5
            assert np.hypot(*(drawn.tips - tip).T).min() < 1.0
            assert ((curve >= 0) & (curve <= 1)).all()
