"""Every numeric field of every settings dataclass refuses what cannot be meant, in one sentence."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import math
import pkgutil
from collections.abc import Iterator
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

import cathsim
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.fluoroscopy.body import Box, Ellipsoid
from cathsim.fluoroscopy.distortion import DetectorDistortion
from cathsim.fluoroscopy.materials import Section, WireMaterial
from cathsim.fluoroscopy.projector import Projector
from cathsim.fluoroscopy.scene import SCENES, XRayScene
from cathsim.planning.path import plan_path
from cathsim.presets import ACCURACY, Accuracy

# composer needs an extra, the console has tests of its own, _native is no module
EXTRAS = {"cathsim.composer", "cathsim.console", "cathsim._native"}
# Dataclasses that hold results or are put together by the code itself, whose numbers no user chooses.
RECORDS = {
    *("anatomy.generator.aorta:Aorta", "anatomy.centreline:LumenPaths"),
    *(
        "anatomy.distance_grid:LatticeField",
        "anatomy.distance_grid:SignedDistanceGrid",
    ),
    *("lattice.node_blocks:NodeBlocks", "lattice.node_set:NodeSet"),
    *("anatomy.entry:Entry", "anatomy.phantom:Phantom", "anatomy.phantom:Target"),
    "anatomy.generator.supra_aortic:_Origin",
    *("anatomy.phantom_cache:PhantomCache", "anatomy.phantom_cache:_FieldReader"),
    *("anatomy.volume.lumen.courses:Courses", "anatomy.volume.lumen.ends:Tip"),
    *("anatomy.volume.labels.family:Family", "anatomy.volume.labels.family:Link"),
    *(
        "anatomy.volume.labels.choice:LabelChoice",
        "anatomy.volume.files.reading:LabelVolume",
        "anatomy.volume.files.source:VolumeSource",
    ),
    *("anatomy.volume.lumen.lattice:BlockLattice", "anatomy.volume.lumen.graph:LumenGraph"),
    *(
        "anatomy.volume.lumen.smoothing:VesselField",
        "anatomy.volume.lumen.union:FlatEnd",
        "anatomy.volume.lumen.union:Union",
    ),
    "devices.device_file:DeviceFile",
    *("anatomy.vessel_tree:Branch", "anatomy.vessel_tree:VesselTree"),
    *("contact.hull_vessel:HullVessel", "contact.hulls:Hull", "contact.sdf:Vessel"),
    *(
        "registration.description:Specification",
        "active_chain:ActiveChains",
        "planning.path:LumenPath",
        "validation:Unit",
    ),
    *(
        "fluoroscopy.c_arms:XRayCamera",
        "fluoroscopy.calibration_file:Projection",
        "fluoroscopy.wire_shadow:ShadowWindow",
    ),
    *(
        "fluoroscopy.radiograph:Radiograph",
        "observations.c_arm_view:CArmClutter",
        "observations.observables:Observable",
        "observations.scan:Scan",
        "robot.cycle:Measured",
        "contact.measured:Contacts",
    ),
    *("metrics.episodes:EpisodeMetrics", "metrics.episodes:Statistic", "metrics.episodes:Summary"),
    "metrics.load_cell:StepForces",
    *("metrics.forces:ForceComparison", "physics_checks.contact:Helix", "physics_checks.rig:TheoryCheck"),
    *("physics_checks.statics:Column", "planning.scripted_motions:Script", "planning.manoeuvres:Manoeuvre"),
    *("statics.ensemble_summary:ContactForces", "statics.ensemble_summary:Estimate", "statics.feeder:Feeder"),
    *("statics.observed_curve:ObservedCurve", "statics.resting_contacts:RestingContacts"),
    *("statics.uncertainty:Deviation", "statics.drawn_errors:DrawnErrors"),
}
# What has no defaults.
EXAMPLES: dict[type[Any], Any] = {
    Accuracy: ACCURACY["accurate"],
    Catheter: Catheter(shape=((0.010, 0.030, 0.5, 0.5),)),
    DevicePair: DevicePair(cathsim.Guidewire(), Catheter()),
    Box: Box((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), 20.0),
    Ellipsoid: Ellipsoid((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), 20.0),
    DetectorDistortion: DetectorDistortion(64, 64),
    Projector: Projector.frontal([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]], 64),
    XRayScene: SCENES["bath"],
    Section: Section(0.1, ((0.3e-3, 800.0), (0.5e-3, 300.0))),
    WireMaterial: WireMaterial((Section(0.1, ((0.3e-3, 800.0),)),)),
}
# Fields of which 0, and of which also -1, can be meant.
_OF_TASK = {"target", "start_jitter", "start_rotation", "force_penalty", "force_threshold", "path_penalty"}
ZERO = {
    "Accuracy": {"tolerance", "rise"},
    "Aneurysm": {"distance", "angle"},
    "ArchParameters": {
        *("arch_skew", "ascending_lean", "arch_tilt", "out_of_plane", "tortuosity", "branch_tortuosity"),
        *("apex_ratio", "bca_takeoff", "lcca_takeoff", "lsa_takeoff", "winding_seed"),
    },
    "BloodFlow": {"peak_velocity", "descending_share", "phase"},
    "Breathing": {"amplitude", "direction"},
    "Box": {"centre", "attenuation"},
    "Catheter": {
        "taper",
        "shape",
        "friction",
        "relaxation",
        "marker_length",
        "wall_attenuation",
        "marker_attenuation",
    },
    "Decomposition": {"seed"},
    "Detector": {
        *("video_noise", "focal_blur", "screen_blur", "glare", "field_centre", "penumbra", "heel", "equalisation"),
    },
    "DetectorDistortion": {"pincushion", "barrel", "twist", "tilt", "centre"},
    "DevicePair": {"most_ahead", "most_behind", "reach"},
    "Ellipsoid": {"centre", "attenuation"},
    "ExpertSettings": {"rounds", "force_cost", "free_force", "most_lead", "confirm", "patience"},
    "Guidewire": {"taper", "tip_angle", "tip_length", "relaxation", "friction", "motor_joints", "motor_angle"},
    "Leader": {"position"},
    "LoadCell": {"resolution", "cutoff"},
    "NavigationTask": _OF_TASK,
    "ArchVarietyTask": _OF_TASK,
    "GoalTask": _OF_TASK,
    "Perturbation": {"walls", "shift", "turn", "stiffness", "friction", "breathing"},
    "Uncertainty": {"stiffness", "insertion", "rotation", "registration", "lumen", "friction", "curve"},
    "ScanArch": {"seed"},
    "VarietyArch": {"seed"},
    "WallRelief": {"coarse", "fine"},
    "XRayScene": {"surroundings", "wall", "wall_thickness", "filling", "scatter"},
    "Section": {"layers"},
}
MINUS_ONE = {
    "Aneurysm": {"angle"},
    "Box": {"centre", "attenuation"},
    "Breathing": {"direction"},
    "Catheter": {"shape"},
    "Detector": {"field_centre"},
    "DetectorDistortion": {"centre", "twist"},
    "Ellipsoid": {"centre", "attenuation"},
    "Guidewire": {"tip_angle"},
    "Leader": {"position"},
    "NavigationTask": {"target"},
    "ArchVarietyTask": {"target"},
    "GoalTask": {"target"},
    "XRayScene": {"wall", "filling"},
}
NEVER = (math.nan, math.inf, -math.inf, 1e300, "text")


def dataclasses_of_the_package() -> dict[str, type[Any]]:
    """Every dataclass that a module of cathsim defines, by module and name."""
    found = {}
    for module in pkgutil.walk_packages(cathsim.__path__, "cathsim."):
        name = module.name
        if any(name == extra or name.startswith(f"{extra}.") for extra in EXTRAS) or ".mesh." in name:
            continue
        for kind in vars(importlib.import_module(name)).values():
            if inspect.isclass(kind) and dataclasses.is_dataclass(kind) and kind.__module__ == name:
                found[f"{name.removeprefix('cathsim.')}:{kind.__qualname__}"] = kind
    return found


FOUND = dataclasses_of_the_package()
SETTINGS = {name: kind for name, kind in FOUND.items() if name not in RECORDS}


def example(kind: type[Any]) -> Any:
    return EXAMPLES[kind] if kind in EXAMPLES else kind()


def is_numeric(annotation: Any) -> bool:
    return annotation in (int, float) or any(is_numeric(part) for part in get_args(annotation))


def fields() -> Iterator[tuple[type[Any], str]]:
    for kind in SETTINGS.values():
        hints = get_type_hints(kind)
        for field in dataclasses.fields(kind):
            if is_numeric(hints[field.name]):
                yield kind, field.name


def variants(present: Any, value: Any) -> Iterator[Any]:
    """The field's value with each of its numbers, or itself, replaced."""
    if isinstance(present, tuple) and present:
        for index, part in enumerate(present[:3]):
            for changed in variants(part, value):
                yield (*present[:index], changed, *present[index + 1 :])
    elif isinstance(present, int | float) or present is None:
        yield value


def numbers(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        for part in value:
            yield from numbers(part)
    elif isinstance(value, int | float):
        yield value


def accepted(kind: type[Any], name: str, value: Any) -> bool:
    base, taken = example(kind), False
    present = getattr(base, name)
    tried = list(variants(present, value)) or [value]
    if issubclass(kind, cathsim.NavigationTask) and name == "target":
        tried = [(0.1, value, 0.1)]
    for changed in tried:
        sentence = ""
        try:
            made = dataclasses.replace(base, **{name: changed})
        except ValueError as error:
            sentence = str(error)
        else:
            assert all(math.isfinite(number) for number in numbers(getattr(made, name)))
            taken = True
        assert "\n" not in sentence
        assert len(sentence) < 400, sentence
    return taken


def test_every_dataclass_is_settings_or_a_record() -> None:
    assert set(FOUND) >= RECORDS, "records that are gone"
    unchecked = [name for name, kind in SETTINGS.items() if not hasattr(kind, "__pydantic_validator__")]
    assert not unchecked, "settings need cathsim.validation.settings; records are listed in this test"
    assert len(SETTINGS) >= 18


@pytest.mark.parametrize(("kind", "name"), list(fields()), ids=lambda value: getattr(value, "__name__", value))
def test_numeric_fields_refuse_what_cannot_be_meant(kind: type[Any], name: str) -> None:
    for value in NEVER:
        assert not accepted(kind, name, value), value
    for value, legal in ((0, ZERO), (-1, MINUS_ONE)):
        assert accepted(kind, name, value) == (name in legal.get(kind.__name__, ())), value
    whole = get_type_hints(kind)[name] is int
    if whole:
        assert not accepted(kind, name, 2.5)
    if isinstance(getattr(example(kind), name), int | float):
        assert not accepted(kind, name, True)


@pytest.mark.parametrize("kind", SETTINGS.values(), ids=lambda kind: kind.__name__)
def test_numpys_numbers_are_taken(kind: type[Any]) -> None:
    base = example(kind)
    for field in dataclasses.fields(kind):
        present = getattr(base, field.name)
        if isinstance(present, bool) or not isinstance(present, int | float):
            continue
        number = np.int64(present) if isinstance(present, int) else np.float64(present)
        assert dataclasses.replace(base, **{field.name: number}) == base or kind.__eq__ is object.__eq__


@dataclasses.dataclass(frozen=True)
class Longer(cathsim.NavigationTask):
    """A task that the standard library's decorator has given a field more."""

    weight: float = 1.0


C_ARM: dict[str, Any] = {"centre": (0.0, 0.0, 0.0), "field_of_view": 0.2}


def test_a_task_with_further_fields_keeps_what_it_was_given() -> None:
    task = Longer(target=np.array([0.1, 0.2, 0.3]), max_steps=np.int64(7), weight=3.0)
    assert (task.target, task.max_steps, task.weight) == ((0.1, 0.2, 0.3), 7, 3.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: cathsim.Guidewire(tip_angle=45.0), r"tip_angle must lie in .* rad, got 45.0; angles are in radians"),
        (lambda: cathsim.Guidewire(diameter=0.89), r"diameter must lie in .* m, got 0.89; lengths are in metres"),
        (lambda: cathsim.Guidewire(links=(16.0,) * 3), r"links\[0\] must lie in .* m, got 16.0; lengths are in metres"),
        (
            lambda: cathsim.Guidewire().scaled(360),
            "the length of a guidewire must lie in .* m, got 360; lengths are in",
        ),
        (lambda: cathsim.Guidewire().scaled(math.nan), "the length of a guidewire must be a finite number"),
        (
            lambda: cathsim.NavigationTask(success_radius=8.0),
            "success_radius must lie in .* m, got 8.0; lengths are in",
        ),
        (
            lambda: cathsim.NavigationTask(start_jitter=1.0),
            "start_jitter must lie in .* m, got 1.0; lengths are in metr",
        ),
        (lambda: cathsim.NavigationTask(start_rotation=180.0), "start_rotation must lie in .* rad, got 180.0; angles"),
        (lambda: cathsim.NavigationTask(max_steps=2.5), "max_steps must be a whole number, got 2.5"),
        (lambda: cathsim.NavigationTask(colour="red"), "NavigationTask has no colour; its fields are target"),
        (lambda: Accuracy(timestep=0.01), "Accuracy needs refinement"),
        (lambda: Longer(success_radius=math.nan), r"success_radius must be a finite number \(m\), got nan"),
        (lambda: Longer(max_steps=2.5), "max_steps must be a whole number, got 2.5"),
        (lambda: Longer(target=(1, 2)), "a target is a name, or a point of three coordinates in m"),
        (lambda: plan_path(None, (), (), clearance=math.nan), r"clearance must be a finite number \(m\), got nan"),
        (lambda: plan_path(None, (), (), aversion=-1.0), "aversion must lie in 0 to 1e.06, got -1.0"),
        (lambda: Projector.c_arm(**C_ARM, size=80.5), "width must be a whole number"),
        (lambda: Projector.c_arm(**C_ARM, size=80, primary_deg=math.nan), "primary_deg must be a finite number"),
        (lambda: Projector.c_arm(**C_ARM, size=80, roll_deg=1e300), "roll_deg must lie in -360 to 360 degrees"),
        (lambda: cathsim.NavigateEnv(image_size=100_000), r"image_size must lie in 16 to 4096 px, got 100000"),
        (lambda: cathsim.NavigateEnv(image_size=80.5), "image_size must be a whole number .*, got 80.5"),
        (lambda: cathsim.NavigateEnv(registration_noise=2.0), "registration_noise must lie in .* m, got 2.0; lengths"),
        (lambda: cathsim.NavigateEnv(registration_noise=math.inf), "registration_noise must be a finite number"),
        (lambda: cathsim.load_phantom("type_1", resolution=1.0), "resolution"),
        (lambda: cathsim.load_phantom("type_1", resolution=math.nan), "resolution"),
        (lambda: cathsim.load_phantom("random", seed=1.5), "seed"),
        (lambda: cathsim.ThreadedVectorEnv(2.5), "num_envs must be a whole number, got 2.5"),
        (lambda: cathsim.ThreadedVectorEnv(2, threads=math.nan), "threads must be a finite number, got nan"),
    ],
)
def test_other_units_and_kinds_are_named(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
