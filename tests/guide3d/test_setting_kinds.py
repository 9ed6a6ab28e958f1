"""Settings: NaN, infinity, slips of sign and size, and texts are refused by the field's name, everywhere."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from typing import Any

import numpy as np
import pytest

import guide3d
from guide3d.calibration.pinhole_fit import IntrinsicPrior
from guide3d.geometry.camera import Camera
from guide3d.geometry.distortion import Distortion
from guide3d.learning import training
from guide3d.learning.build import ShapeSize
from guide3d.learning.losses import ShapeLoss
from guide3d.learning.preprocessing import Preprocessing
from guide3d.learning.reader.training import ReaderRecipe
from guide3d.learning.recipes import fgrn_recipe, segmentation_recipe, shape_recipe
from guide3d.learning.segmentation_samples import SegmentationAugmentation
from guide3d.learning.shape_samples import ShapeAugmentation
from guide3d.modeling.spherical import SphericalForm
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.centreline import CentrelineSettings
from guide3d.reading.curve_reading import CurveReadingSettings
from guide3d.reading.links import LinkSettings
from guide3d.reading.pair_reading import PairReadingSettings
from guide3d.reading.path_search import SearchSettings
from guide3d.reading.proximal_end import ProximalEndSettings
from guide3d.reading.ridges import RidgeSettings
from guide3d.reconstruction import curve_fitting
from guide3d.reconstruction.matching import MatchingSettings
from guide3d.reconstruction.reconstruction import ReconstructionSettings
from guide3d.reconstruction.synthetic_scene import rig
from tests.number_fields import accepted, parametrised

POINTS = np.zeros((4, 2))
WORLD = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# settings to the bad numbers that are good ones there
EVERYTHING: dict[Any, str] = {
    rig()[0]: "",
    Distortion(POINTS, POINTS, 64, 64): "",
    IntrinsicPrior(): "",
    MatchingSettings(): "length_per_mm=0 tip_reach_px=0 uneven_per_px=0",
    curve_fitting.CurveFitSettings(): "",
    ReconstructionSettings(): "annotation_px=0 outside_px=0",
    Preprocessing(64): "flat_px=0 line_px=0",
    SphericalForm(1.7, WORLD, 0.0, 1.5): "axes=-1 azimuth=-1 azimuth=0 polar=-1 polar=0",
    ShapeSize(stem=(8, 8)): "dropout=0 kept=0",
    ShapeLoss(): "curve=0 length=0 offset=0 stop=0 tip=0",
    ShapeAugmentation(): "gain=0 noise=0 shift_px=0",
    SegmentationAugmentation(): "gain=0 noise=0 offset=0 on_wire=0",
    training.NetworkFitSettings(): "clip=0 patience=0 plateau_patience=0 weight_decay=0",
    shape_recipe("desk"): "",
    CentrelineSettings(): "blend_points=0 growth=0",
    LinkSettings(): "empty_per_px=0 kink=0 kink_from=-1 kink_from=0 longest=0 unseen_from=-1 unseen_from=0 "
    "unseen_turn=0",
    ProximalEndSettings(): "longest=0 turn=-1 turn=0",
    RidgeSettings(): "high=0 junction_px=0 low=0 worth_above=0",
    SearchSettings(): "guessed=0 twice_per_px=0",
    CurveReadingSettings(): "border_link=0 border_tip=0 loose_end=0 tip_cost=0 tip_least=0 tip_link=0",
    PairReadingSettings(): "coverage=0 least_coverage=0 residual_per_px=0",
    FluoroscopySettings(): "along_edge=0 anatomy=0 background=0 beads=0 catheter=0 contrast=0 field=0 given_course=0 "
    "in_vessel=0 jpeg=0 markers=0 near_tip=0 near_wire=0 no_wire=0 noise=0 tip_change=0 two_devices=0",
    ReaderRecipe(): "average=0 catheter=0 dice=0 tip=0 warm_up=0 weight_decay=0",
}
RECIPES = (fgrn_recipe("desk"), segmentation_recipe("unet", "desk"))  # with dictionaries: not to be hashed


@parametrised(EVERYTHING)
def test_numbers_that_cannot_be_meant_are_refused_by_name(settings: Any, legal: set[str]) -> None:
    assert accepted(settings) == legal


def test_numbers_of_recipes_that_cannot_be_meant_are_refused_by_name() -> None:
    assert accepted(RECIPES[0]) == set()
    assert accepted(RECIPES[1]) == {"dice=0", "images=0", "validation_images=0"}


def test_no_settings_are_left_out() -> None:
    names = [
        module.name
        for module in pkgutil.walk_packages(guide3d.__path__, "guide3d.")
        if not module.name.endswith("_native")  # a library in C, which cannot be imported
    ]
    found = {
        value
        for name in names
        for value in vars(importlib.import_module(name)).values()
        if isinstance(value, type) and dataclasses.is_dataclass(value) and hasattr(value, "__pydantic_validator__")
    }
    assert found == {type(one) for one in (*EVERYTHING, *RECIPES)}


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_arrays_of_cameras_and_distortions_are_finite(value: float) -> None:
    camera = rig()[0]
    for name in ("K", "R", "t_mm"):
        with pytest.raises(ValueError, match=f"{name} should be .* of finite numbers"):
            dataclasses.replace(camera, **{name: np.full_like(getattr(camera, name), value)})
    with pytest.raises(ValueError, match="control points must be finite"):
        Distortion(POINTS, POINTS + value, 64, 64)
    assert isinstance(Camera(camera.K.tolist(), camera.R, camera.t_mm, 64, 64).K, np.ndarray)
