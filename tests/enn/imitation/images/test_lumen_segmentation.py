"""The network that finds the lumen: lumens that it has not seen, and the same weights from the same seed."""

from __future__ import annotations

import pytest
import torch

from enn.imitation.images.lumen_segmentation import fit_segmenter, overlap
from tests.enn.imitation.straight_wire import SIZE, vessels


def test_segmenter_finds_lumens_it_has_not_seen() -> None:
    images, lumens = vessels(24, 0)
    segmenter, _ = fit_segmenter(images, lumens, epochs=12, working_size=SIZE)
    images, lumens = vessels(8, 1)
    assert overlap(segmenter, images, lumens) > 0.8
    assert overlap(segmenter, 0.5 * images + 60, lumens) > 0.8  # brightness and contrast do not matter


def test_segmenter_is_the_same_from_the_same_seed() -> None:
    images, lumens = vessels(4, 0)
    weights = [fit_segmenter(images, lumens, epochs=1, working_size=SIZE, seed=3)[0].state_dict() for _ in range(2)]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
    with pytest.raises(ValueError, match="expected images and lumens of one shape"):
        fit_segmenter(images, lumens[:2])
