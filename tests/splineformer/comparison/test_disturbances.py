"""Disturbances of images: what each does, that it repeats, and that others are refused."""

from __future__ import annotations

import numpy as np
import pytest

from splineformer.comparison.evaluation import BARS, DETECTOR_SD, GAIN, KINDS, NOISE_SD, disturbed
from tests.splineformer.curves import image_of, wavy_wire

WIRE = wavy_wire(0, 1024)
IMAGE = image_of(WIRE, 1024)


def result(kind: str, seed: int = 0) -> np.ndarray:
    return disturbed(kind, IMAGE, WIRE, np.random.default_rng(seed))


@pytest.mark.parametrize("kind", KINDS)
def test_disturbances_repeat(kind: str) -> None:
    assert result(kind).dtype == np.uint8
    assert result(kind).shape == IMAGE.shape
    assert np.array_equal(result(kind), result(kind))
    assert (result(kind) is IMAGE) == (kind == "none")


def test_what_each_does() -> None:
    change = result("noise").astype(float) - IMAGE
    assert change.std() == pytest.approx(NOISE_SD, rel=0.05)
    assert result("low_contrast").std() == pytest.approx(np.hypot(GAIN * IMAGE.std(), DETECTOR_SD), rel=0.02)
    hidden = result("occlusion") != IMAGE
    assert 0.001 < hidden.mean() < BARS * (72 / 1024) ** 2
    column, row = WIRE.round().astype(int).T
    on_wire = hidden[row.clip(0, 1023), column.clip(0, 1023)]
    assert on_wire.any()
    assert not on_wire[[0, -1]].any()  # tip and end stay in sight


def test_other_disturbances_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown disturbance 'blur'; there are none, noise"):
        result("blur")
