"""Every number of every settings class refuses NaN, infinity and text in one sentence that names the field."""

import dataclasses
import importlib
import inspect
import pkgutil
import typing
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import cathsim
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.fluoroscopy.distortion import DetectorDistortion
from cathsim.fluoroscopy.materials import Section, WireMaterial
from cathsim.fluoroscopy.projector import Projector
from cathsim.fluoroscopy.scene import SCENES, Box, Ellipsoid
from cathsim.presets import ACCURACY
from enn.imitation.recurrent_policy import RecurrentPolicySettings
from enn.reinforcement.training.settings import TrainingSettings
from guide3d.geometry.distortion import Distortion
from guide3d.learning.picture_store import Preprocessing
from guide3d.learning.recipes import fgrn_recipe, segmentation_recipe, shape_recipe
from guide3d.modeling.spherical import SphericalForm
from guide3d.reconstruction.synthetic_scene import rig
from splineformer.learning.fluoroscopy_training import fluoroscopy_recipe
from splineformer.learning.recipes import recipe_of
from tests.integration.documents.pages import PACKAGES

BAD = {"NaN": float("nan"), "infinity": float("inf"), "a large number": 1e300, "text": "five"}
# What has no defaults.
EXAMPLES = (
    ACCURACY["accurate"],
    DevicePair(cathsim.Guidewire(), Catheter()),
    Box((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), 20.0),
    Ellipsoid((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), 20.0),
    DetectorDistortion(64, 64),
    Projector.frontal([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]], 64),
    SCENES["bath"],
    Section(0.1, ((0.3e-3, 800.0), (0.5e-3, 300.0))),
    WireMaterial((Section(0.1, ((0.3e-3, 800.0),)),)),
    RecurrentPolicySettings(features=8),
    rig()[0],
    Distortion(np.zeros((4, 2)), np.zeros((4, 2)), 64, 64),
    Preprocessing(64),
    SphericalForm(1.7, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), 0.0, 1.5),
    shape_recipe("desk"),
    fgrn_recipe("desk"),
    segmentation_recipe("unet", "desk"),
    recipe_of("ordered", "desk"),
    recipe_of("published", "desk").settings,
    fluoroscopy_recipe("ordered", "desk"),
)


def settings_of(package: str) -> Iterator[Any]:
    """An object of each class of a package whose fields are checked."""
    known = {type(one): one for one in EXAMPLES}
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if module.name.endswith(("_native", "__main__")) or ".composer" in module.name or ".console" in module.name:
            continue
        for kind in vars(importlib.import_module(module.name)).values():
            ours = dataclasses.is_dataclass(kind) and getattr(kind, "__module__", "") == module.name
            if (
                ours
                and hasattr(kind, "__pydantic_validator__")
                and inspect.isclass(kind)
                and kind is not TrainingSettings
            ):
                yield known[kind] if kind in known else kind()


def with_number(present: Any, value: Any) -> Iterator[Any]:
    """What a field holds with its first number, or itself, replaced."""
    if isinstance(present, tuple) and present:
        yield from ((changed, *present[1:]) for changed in with_number(present[0], value))
    elif (isinstance(present, int | float) and not isinstance(present, bool)) or present is None:
        yield value


def has_numbers(hint: Any) -> bool:
    return hint in (int, float) or any(has_numbers(part) for part in typing.get_args(hint))


def refusal(settings: Any, field: str, value: Any) -> str:
    """The sentence with which a value is refused; empty where it is taken."""
    try:
        dataclasses.replace(settings, **{field: value})
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_no_number_is_refused_by_name(package: str) -> None:
    fields = 0
    for settings in settings_of(package):
        hints = typing.get_type_hints(type(settings), include_extras=True)
        for field in dataclasses.fields(settings):
            named = isinstance(settings, cathsim.NavigationTask) and field.name == "target"  # a text is a name
            if not has_numbers(hints[field.name]) or named:
                continue
            fields += 1
            for word, value in BAD.items():
                for changed in with_number(getattr(settings, field.name), value):
                    said = refusal(settings, field.name, changed)
                    assert said, f"{word} as {field.name} of {type(settings).__name__} is taken"
                    assert "\n" not in said
                    # cathsim's sentences may name a field in words of their own
                    assert package == "cathsim" or field.name in said
    assert fields > 30
