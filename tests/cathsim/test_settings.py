"""Settings: slips of unit and kind are named in one sentence."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import cathsim
from cathsim.fluoroscopy.projector import Projector
from cathsim.planning.path import plan_path
from cathsim.presets import Accuracy


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
        (
            lambda: cathsim.NavigationTask(success_radius=8.0),
            "success_radius must lie in .* m, got 8.0; lengths are in",
        ),
        (lambda: cathsim.NavigationTask(start_rotation=180.0), "start_rotation must lie in .* rad, got 180.0; angles"),
        (lambda: cathsim.NavigationTask(max_steps=2.5), "max_steps must be a whole number, got 2.5"),
        (lambda: cathsim.NavigationTask(max_steps=True), "max_steps must be a whole number, got True"),
        (lambda: cathsim.Guidewire(friction=True), "friction must be a number, got True"),
        (lambda: cathsim.NavigationTask(colour="red"), "NavigationTask has no colour; its fields are target"),
        (lambda: Accuracy(timestep=0.01), "Accuracy needs refinement"),
        (lambda: Longer(success_radius=math.nan), r"success_radius must be a finite number \(m\), got nan"),
        (lambda: Longer(target=(1, 2)), "a target is a name, or a point of three coordinates in m"),
        (lambda: plan_path(None, (), (), clearance=math.nan), r"clearance must be a finite number \(m\), got nan"),
        (lambda: Projector.c_arm(**C_ARM, size=80.5), "width must be a whole number"),
        (lambda: Projector.c_arm(**C_ARM, size=80, roll_deg=1e300), "roll_deg must lie in -360 to 360 degrees"),
        (lambda: cathsim.NavigateEnv(image_size=100_000), r"image_size must lie in 16 to 4096 px, got 100000"),
        (lambda: cathsim.NavigateEnv(registration_noise=2.0), "registration_noise must lie in .* m, got 2.0; lengths"),
        (lambda: cathsim.load_phantom("type_1", resolution=1.0), "resolution"),
        (lambda: cathsim.load_phantom("random", seed=1.5), "seed"),
        (lambda: cathsim.ThreadedVectorEnv(2.5), "num_envs must be a whole number, got 2.5"),
    ],
)
def test_other_units_and_kinds_are_named(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
