"""Settings: NaN, infinity, slips of sign and size, and texts are refused by the field's name, everywhere."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from typing import Any

import splineformer
from splineformer.comparison.skeleton import SkeletonSettings
from splineformer.learning.augmentation import Augmentation
from splineformer.learning.fluoroscopy_training import fluoroscopy_recipe
from splineformer.learning.losses import OrderedWeights, PublishedWeights
from splineformer.learning.recipes import recipe_of
from splineformer.modeling.ordered import OrderedSettings
from splineformer.modeling.published import SplineFormerSettings
from splineformer.navigation.camera_view import ViewSettings
from splineformer.navigation.navigator_perception import NavigatorPerceptionSettings
from splineformer.tokens import TokenSettings
from tests.number_fields import accepted, parametrised

# settings to the bad numbers that are good ones there
EVERYTHING: dict[Any, str] = {
    Augmentation(): "empty=0 gain=0 hidden=0 inverted=0 noise=0 offset=0 several=0 shift=0 stretch=0 "
    "turn_a_pass=0 turn_deg=0",
    OrderedWeights(): "course=0 curve=0 kind=0 length=0 offset=0 on_wire=0 overview=0 refined=0 revised=0 "
    "spread=0 tip=0",
    PublishedWeights(): "curve=0 end=0 kind=0 knots=0 points=0 tip=0",
    OrderedSettings(): "blocks=0 overview_level=0 revision_layers=0",
    SplineFormerSettings(): "dropout=0",
    NavigatorPerceptionSettings(): "",
    ViewSettings(): "",
    SkeletonSettings(): "smallest_px=0 widest_gap_px=0",
    TokenSettings(): "closest_px=0 tolerance_px=0",
    recipe_of("ordered", "desk"): "images=0 validation_images=0",
    fluoroscopy_recipe("ordered", "desk"): "drawn=0",
}


@parametrised(EVERYTHING)
def test_numbers_that_cannot_be_meant_are_refused_by_name(settings: Any, legal: set[str]) -> None:
    assert accepted(settings) == legal


def test_no_settings_are_left_out() -> None:
    names = [module.name for module in pkgutil.walk_packages(splineformer.__path__, "splineformer.")]
    found = {
        value
        for name in names
        for value in vars(importlib.import_module(name)).values()
        if isinstance(value, type)
        and dataclasses.is_dataclass(value)
        and hasattr(value, "__pydantic_validator__")
        and value.__module__.startswith("splineformer")
    }
    assert found == {type(one) for one in EVERYTHING}
