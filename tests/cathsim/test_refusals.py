"""What cannot be is refused in a sentence that says what there is; slips of unit and kind are named."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import cathsim
from cathsim import ACCURACY, Guidewire, NavigateEnv, NavigationTask, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.anatomy.generator.scan_arch import ScanArch
from cathsim.blood.field import blood_field
from cathsim.blood.flow import FLOWS
from cathsim.contact.hulls import Decomposition
from cathsim.fluoroscopy.projector import Projector
from cathsim.goals.environment import NavigateGoalEnv
from cathsim.goals.task import GoalTask
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.metrics.load_cell import LoadCell
from cathsim.observations.c_arm_view import CArmClutter, CArms
from cathsim.observations.observables import make_observable
from cathsim.observations.xray import XrayEnvironment
from cathsim.planning.path import plan_path
from cathsim.presets import Accuracy
from tests.cathsim.drawn_vessels import tube

C_ARM: dict[str, Any] = {"centre": (0.0, 0.0, 0.0), "field_of_view": 0.2}


@dataclasses.dataclass(frozen=True)
class Longer(NavigationTask):
    """A task that the standard library's decorator has given a field more."""

    weight: float = 1.0


def arch() -> Phantom:
    return load_phantom("type_1")


def without_a_target() -> None:
    environment = NavigateEnv(arch())
    make_observable("roadmap", environment.simulation, environment.fluoroscope)


def many(**arguments: Any) -> NavigateManyEnv:
    return NavigateManyEnv(**{"phantoms": (arch(),), "targets": ("bca",), "observation": "joints", **arguments})


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: ScanArch(0, "flat"), "common, steep, trunk, got 'flat'"),
    (lambda: arch().wall_mesh(1.5), r"thickness must lie in \(0, 0.005\] m, got"),
    (lambda: blood_field(arch(), FLOWS["steady"]).velocity(np.zeros((4, 2))), r"shape \(\.\.\., 3\), got \(4, 2\)"),
    (lambda: tube().distance(np.zeros((4, 2))), r"shape \(n, 3\), got \(4, 2\)"),
    (lambda: NavigateEnv(arch(), entry=tuple(arch().tree.root.point_at(0.05)), contact="hulls"), "an entry at an open"),
    (lambda: NavigateEnv(arch()).reset(options={"where": 1}), "reset knows no option where; there are start, target"),
    (lambda: load_guidewire("default", stiffness=3.0), "has no stiffness.*shaft_stiffness_nmm2"),
    (lambda: Simulation(arch(), load_guidewire("default", links=(0.004,) * 5), ACCURACY["fast"]), "is too short"),
    (lambda: many(targets="bca"), "targets must list at least one, got 'bca'"),
    (lambda: many(target="bca"), "takes targets, a list, instead of target"),
    (lambda: Decomposition(thickness=0.02), r"thickness must lie in 0 \(excluded\) to 0\.005 m, got 0\.02"),
    (lambda: many().describe(4), "there is no case 4: they are numbered from 0 to 0"),
    (lambda: many().reset(options={"cases": 1}), "reset knows no option cases"),
    (lambda: many(wires=("default", "thesis")).reset(options={"case": 1}), "must give the same spaces"),
    (lambda: NavigateEnv(arch(), scan="x"), "scan must be a Scan, got 'x'"),
    (lambda: NavigateEnv(arch(), view=25.0), "view must be a list, got 25.0"),
    (lambda: NavigateEnv(arch(), view=(float("nan"), 0)), "view.*finite number"),
    (lambda: NavigateEnv(arch(), observation=("tip", 3)), r"observation must name .*, got \('tip', 3\)"),
    (lambda: NavigateGoalEnv(arch(), observe_every=3), "observe_every must be 1"),
    (lambda: XrayEnvironment(NavigateEnv(arch(), observation="tip"), 64), "has a dictionary of observations"),
    (lambda: LoadCell().read(np.zeros((4, 2)), interval=0.1, generator=np.random.default_rng(0)), "finite loads"),
    (lambda: NavigationTask(reward=3), "reward must be a name, .*or a function, got 3"),
    (lambda: NavigationTask(success="near"), "success: .*got 'near'"),
    (lambda: GoalTask(success="lumen"), "success must be 'straight'"),
    (lambda: GoalTask().goal_reward(np.zeros((3, 3)), np.zeros(3), {}), "two arrays of one shape"),
    (lambda: CArms(("a", "b"), 256, clutter=CArmClutter((np.zeros((256, 256), np.float32),))), "for each camera"),
    (without_a_target, "'roadmap' needs a target"),
    (lambda: Guidewire(tip_angle=45.0), r"tip_angle must lie in .* rad, got 45.0; angles are in radians"),
    (lambda: Guidewire(links=(16.0,) * 3), r"links\[0\] must lie in .* m, got 16.0; lengths are in metres"),
    (lambda: Guidewire().scaled(360), "the length of a guidewire must lie in .* m, got 360; lengths are in"),
    (lambda: NavigationTask(max_steps=2.5), "max_steps must be a whole number, got 2.5"),
    (lambda: NavigationTask(colour="red"), "NavigationTask has no colour; its fields are target"),
    (lambda: Accuracy(timestep=0.01), "Accuracy needs refinement"),
    (lambda: Longer(success_radius=math.nan), r"success_radius must be a finite number \(m\), got nan"),
    (lambda: Longer(target=(1, 2)), "a target is a name, or a point of three coordinates in m"),
    (lambda: plan_path(None, (), (), clearance=math.nan), r"clearance must be a finite number \(m\), got nan"),
    (lambda: Projector.c_arm(**C_ARM, size=80.5), "width must be a whole number"),
    (lambda: Projector.c_arm(**C_ARM, size=80, roll_deg=1e300), "roll_deg must lie in -360 to 360 degrees"),
    (lambda: NavigateEnv(image_size=100_000), r"image_size must lie in 16 to 4096 px, got 100000"),
    (lambda: NavigateEnv(registration_noise=2.0), "registration_noise must lie in .* m, got 2.0; lengths"),
    (lambda: load_phantom("random", seed=1.5), "seed"),
    (lambda: cathsim.ThreadedVectorEnv(2.5), "num_envs must be a whole number, got 2.5"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_it_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_a_closed_environment_says_so() -> None:
    environment = NavigateEnv(arch())
    environment.close()
    for use in (environment.reset, lambda: environment.step(np.zeros(2))):
        with pytest.raises(RuntimeError, match="the environment is closed"):
            use()


def test_a_task_with_further_fields_keeps_what_it_was_given() -> None:
    task = Longer(target=np.array([0.1, 0.2, 0.3]), max_steps=np.int64(7), weight=3.0)
    assert (task.target, task.max_steps, task.weight) == ((0.1, 0.2, 0.3), 7, 3.0)
