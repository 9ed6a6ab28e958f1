"""Sizes, and networks built again from their description."""

from __future__ import annotations

import pytest
import torch

from splineformer.build import SIZES, VARIANTS, build, described, rebuilt, size_of
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.published import SplineFormer


def network(variant: str, size: str = "smoke") -> SplineFormer | OrderedSplineFormer:
    torch.manual_seed(0)
    return build(size_of(variant, size)).eval()


@pytest.mark.parametrize("variant", VARIANTS)
def test_described_and_rebuilt(variant: str) -> None:
    model = network(variant)
    again = rebuilt(described(model))
    assert again.settings == model.settings
    assert again.load_state_dict(model.state_dict())
    with pytest.raises(ValueError, match="layout 0, this version reads 2"):
        rebuilt(described(model) | {"layout": 0})
    with pytest.raises(ValueError, match="another version"):
        rebuilt(described(model) | {"settings": {"colour": 3}})


def test_unknown_variant_and_size() -> None:
    with pytest.raises(ValueError, match="published, ordered"):
        size_of("other", "desk")
    with pytest.raises(ValueError, match="thesis, desk, smoke"):
        size_of("ordered", "huge")
    assert set(SIZES) == set(VARIANTS)
