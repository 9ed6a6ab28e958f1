"""What cannot be is refused in a sentence that says what there is."""

from collections.abc import Callable

import numpy as np
import pytest

from cathsim import ACCURACY, NavigateEnv, NavigationTask, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.anatomy.generator.scan_arch import ScanArch
from cathsim.blood.field import blood_field
from cathsim.blood.flow import FLOWS
from cathsim.devices.shelf import catheter_shape
from cathsim.goals.environment import NavigateGoalEnv
from cathsim.goals.task import GoalTask
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.metrics.load_cell import LoadCell
from cathsim.observations.c_arm_view import CArmClutter, CArms
from cathsim.observations.observables import make_observable
from cathsim.observations.xray import XrayEnvironment
from tests.cathsim.drawn_vessels import tube


def arch() -> Phantom:
    return load_phantom("type_1")


def clutter(size: int) -> np.ndarray:
    return np.zeros((size, size), np.float32)


def closed() -> NavigateEnv:
    environment = NavigateEnv(arch())
    environment.close()
    return environment


def without_a_target() -> None:
    environment = NavigateEnv(arch())
    make_observable("roadmap", environment.simulation, environment.fluoroscope)


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: ScanArch(0, "flat"), "common, steep, trunk, got 'flat'"),
    (lambda: arch().wall_mesh(1.5), r"thickness must lie in \(0, 0.005\] m, got"),
    (lambda: blood_field(arch(), FLOWS["steady"]).velocity(np.zeros((4, 2))), r"shape \(\.\.\., 3\), got \(4, 2\)"),
    (lambda: tube().distance(np.zeros((4, 2))), r"shape \(n, 3\), got \(4, 2\)"),
    (
        lambda: NavigateEnv(arch(), entry="femoral"),
        "unknown entry 'femoral' in phantom .*choose from .*lsa_end",
    ),
    (
        lambda: NavigateEnv(arch(), entry=tuple(arch().tree.root.point_at(0.05)), contact="hulls"),
        "an entry at an open",
    ),
    (lambda: NavigateEnv(arch()).reset(options={"where": 1}), "reset knows no option where; there are start, target"),
    (lambda: NavigateEnv(arch()).reset(options={"start": np.zeros(3)}), "expected a state of shape"),
    (lambda: catheter_shape("hook"), "unknown catheter 'hook'"),
    (lambda: load_guidewire("default", stiffness=3.0), "has no stiffness.*shaft_stiffness_nmm2"),
    (
        lambda: Simulation(arch(), load_guidewire("default", links=(0.004,) * 5), ACCURACY["fast"]),
        r"a wire of 0\.020 m is too short",
    ),
    (lambda: NavigateManyEnv((arch(),), ("bca",)).describe(4), "there is no case 4: they are numbered from 0 to 0"),
    (lambda: NavigateManyEnv((arch(),), ("bca",)).reset(options={"cases": 1}), "reset knows no option cases"),
    (
        lambda: NavigateManyEnv((arch(),), ("bca",), ("default", "thesis"), observation="joints").reset(
            options={"case": 1}
        ),
        "must give the same spaces of observations and actions",
    ),
    (
        lambda: NavigateManyEnv((arch(),), ("bca",), ("default", None), catheter="vertebral", observation="tip").reset(
            options={"case": 1}
        ),
        "must give the same spaces of observations and actions",
    ),
    (lambda: NavigateEnv(arch(), scan="x"), "scan must be a Scan, got 'x'"),
    (lambda: NavigateEnv(arch(), view=25.0), "view must be a list, got 25.0"),
    (lambda: NavigateEnv(arch(), view=(float("nan"), 0)), "view.*finite number"),
    (lambda: NavigateEnv(arch(), observation=None), "observation must name at least one observable, got None"),
    (lambda: NavigateEnv(arch(), observation=("tip", 3)), r"observation must name .*, got \('tip', 3\)"),
    (lambda: NavigateGoalEnv(arch(), observe_every=3), "observe_every must be 1"),
    (lambda: XrayEnvironment(NavigateEnv(arch(), observation="tip"), 64), "has a dictionary of observations"),
    (lambda: LoadCell().read(np.zeros((4, 2)), interval=0.1, generator=np.random.default_rng(0)), "finite loads"),
    (lambda: NavigationTask(reward=3), "reward must be a name, distance or geodesic, or a function, got 3"),
    (lambda: NavigationTask(success="near"), "success: input should be 'lumen' or 'straight', got 'near'"),
    (lambda: GoalTask(success="lumen"), "success must be 'straight' in a goal-conditioned task"),
    (lambda: GoalTask().goal_reward(np.zeros((3, 3)), np.zeros(3), {}), "two arrays of one shape"),
    (lambda: CArms(("a", "b"), 256, clutter=CArmClutter((clutter(256),))), r"shape \(256, 256\) for each camera"),
    (without_a_target, "'roadmap' needs a target"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_it_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_a_closed_environment_says_so() -> None:
    for use in (closed().reset, lambda: closed().step(np.zeros(2))):
        with pytest.raises(RuntimeError, match="the environment is closed: make it again"):
            use()
