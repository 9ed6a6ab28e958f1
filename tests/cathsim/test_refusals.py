"""What cannot be is refused in a sentence that says what there is; slips of unit and kind are named."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import cathsim
from cathsim import ACCURACY, Guidewire, NavigateEnv, NavigationTask, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.generator.scan_arch import ScanArch
from cathsim.arch_variety import ArchVarietyEnv
from cathsim.blood.field import blood_field
from cathsim.blood.flow import FLOWS, BloodFlow
from cathsim.contact.hulls import Decomposition
from cathsim.contact.sdf import Vessel
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.dual_device_nav import RandomTreesEnv
from cathsim.fluoroscopy import Detector, Section, WireMaterial, XRayScene
from cathsim.fluoroscopy.projector import Projector
from cathsim.goals.environment import NavigateGoalEnv
from cathsim.goals.task import GoalTask
from cathsim.lattice.node_blocks import NodeBlocks
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.metrics.load_cell import LoadCell
from cathsim.observations.c_arm_view import CArmClutter, CArms
from cathsim.observations.observables import make_observable
from cathsim.observations.xray import XrayEnvironment
from cathsim.planning.path import plan_path
from cathsim.planning.plan_trials import ExpertSettings
from cathsim.planning.sampling import SamplingExpert
from cathsim.presets import Accuracy, Pace
from cathsim.rehearsal.environment import NavigateCopiesEnv
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


def navigate(**arguments: Any) -> NavigateEnv:
    return NavigateEnv(**{"accuracy": "fast", **arguments})


def goal_env(**arguments: Any) -> NavigateGoalEnv:
    return NavigateGoalEnv("type_1", **{"goals": ("bca",), "accuracy": "fast", **arguments})


UP = np.array([0.0, 0.0, 1.0])


def vessel(values: np.ndarray, direction: np.ndarray) -> Vessel:
    return Vessel(SignedDistanceGrid(values, np.zeros(3), 0.001), np.zeros(3), direction)


def nodes(indices: list, values: list, shape: tuple) -> NodeBlocks:
    return NodeBlocks.from_nodes(indices, np.array(values, np.float32), shape, -1.0)


def walled(accuracy: str, stiffness: float) -> Simulation:
    return Simulation(arch(), Guidewire(), ACCURACY[accuracy], wall_stiffness=stiffness)


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
    (lambda: navigate(phantom="aorta"), "unknown phantom 'aorta'; choose from type_1, "),
    (lambda: navigate(phantom="random"), "phantom 'random' needs a seed"),
    (lambda: navigate(target="coronary"), "unknown target 'coronary'"),
    (lambda: navigate(wire="steel"), "unknown guidewire 'steel'"),
    (lambda: navigate(accuracy="exact"), "unknown accuracy 'exact'"),
    (lambda: navigate(actions="tip"), "unknown actions 'tip'"),
    (lambda: navigate(observation="pixels"), "unknown observation 'pixels'"),
    (lambda: navigate(observation=()), "observation must name at least one observable"),
    (lambda: navigate(render_mode="ansi"), "unknown render_mode 'ansi'"),
    (lambda: navigate(reward="sparse"), "unknown reward 'sparse'"),
    (lambda: navigate(colour="red"), "the environment has no argument colour"),
    (
        lambda: navigate(catheter=load_catheter("straight", inner_diameter=0.8e-3)),
        "a wire of 0.89 mm does not pass a catheter",
    ),
    (lambda: navigate(catheter="simmons9"), "unknown catheter 'simmons9'"),
    (lambda: navigate(catheter="there_is_none.yaml"), "there_is_none.yaml"),
    (lambda: navigate(catheter=5), "catheter must be .*got 5"),
    (lambda: navigate(catheter="vertebral", actions="tip_motors"), "without tip motors"),
    (lambda: navigate(catheter="vertebral", contact="hulls"), "with contact 'sdf' and without tip motors"),
    (lambda: navigate(catheter="vertebral", torsion="soft"), "unknown torsion 'soft'"),
    (lambda: navigate(wire=None), "neither a wire nor a catheter is there"),
    (lambda: navigate(observation="devices"), "observation 'devices' needs a catheter"),
    (lambda: navigate(wire=5), "wire must be .*got 5"),
    (lambda: navigate(phantom=3), "phantom must be .*got 3"),
    (lambda: navigate(accuracy=None), "accuracy must be .*got None"),
    (lambda: navigate(blood=1.0), "blood must be a name or a BloodFlow"),
    (lambda: navigate(contact=1), "contact must be a name or a Decomposition"),
    (lambda: navigate(cameras={"size": 3}), "cameras must be a name or a BiplaneFluoroscope"),
    (lambda: navigate(task="reach"), "task must be a NavigationTask"),
    (lambda: goal_env(observation=("joints", "roadmap")), "observation roadmap depends on the target"),
    (lambda: goal_env(observation=("joints", "image")), "got joints, image"),
    (lambda: goal_env(goals=()), "goals must list at least one"),
    (lambda: goal_env(goals="bca"), "goals must list at least one .*got 'bca'"),
    (lambda: goal_env(goals=("bca", "nowhere")), "nowhere"),
    (lambda: goal_env(target="bca"), "instead of a target"),
    (lambda: goal_env(task=NavigationTask()), "task must be a GoalTask"),
    (lambda: goal_env(reward="geodesic"), "unknown reward 'geodesic'"),
    (lambda: goal_env(path_penalty=1.0), "path_penalty must be 0"),
    (lambda: NavigateCopiesEnv(arch(), copies=()), "copies must list at least one seed"),
    (lambda: NavigateCopiesEnv(arch(), copies=(-1,)), r"none below 0, got \[-1\]"),
    (lambda: NavigateCopiesEnv(arch(), breathing=None), "their own breathing"),
    (lambda: NavigateCopiesEnv(arch(), perturbation="strong"), "perturbation must be .*got 'strong'"),
    (lambda: NavigateCopiesEnv(arch(), wire=None), "wire's stiffness"),
    (lambda: BloodFlow(peak_velocity=-1.0), "peak_velocity must lie in 0 to 20 m/s, got -1.0"),
    (lambda: BloodFlow(waveform="square"), "unknown waveform 'square'; there are pulsatile, steady"),
    (lambda: BloodFlow(shares={"lcca": 0.5}), "sum to at most 1 with descending_share"),
    (lambda: BloodFlow(phase=math.nan), "phase must be a finite number"),
    (lambda: load_guidewire("default", links=(0.01,)), "links needs at least 2 entries, got 1"),
    (
        lambda: load_guidewire("default", links=(0.01, -0.01)),
        r"links\[1\] must lie in 0 \(excluded\) to 0.5 m, got -0.01",
    ),
    (lambda: load_guidewire("default", links=(0.01, 0.0005)), "shorter than the diameter"),
    (lambda: load_guidewire("default", tip_stiffness_nmm2=np.nan), "tip_stiffness_nmm2 must be a finite number"),
    (lambda: load_guidewire("default", friction=-0.1), "friction must lie in 0 to 10, got -0.1"),
    (lambda: load_guidewire("default", taper=(0.06, 0.02)), "two increasing distances"),
    (
        lambda: load_catheter("cobra"),
        "unknown catheter 'cobra'; there are straight, vertebral.*, or a path of a .yaml file",
    ),
    (lambda: load_catheter("simmons2_9f"), "'simmons2' is not made in 9F: it has 4F, 5F, 6F"),
    (lambda: load_catheter("simmons2", french=9), "'simmons2' is not made in 9F"),
    (lambda: load_catheter("simmons2", french=True), "french must be a whole number, got True"),
    (lambda: load_catheter("simmons2", length=True), "length must be a number .m., got True"),
    (lambda: load_catheter("simmons2_6f", french=5), "is of 6F, but french=5 is asked for"),
    (
        lambda: load_catheter("simmons2", stiffness=3.0),
        "Catheter has no stiffness; its fields are outer_diameter",
    ),
    (lambda: Catheter(inner_diameter=2e-3), r"inner diameter .*2 mm.* smaller than its outer one .*1.67 mm"),
    (lambda: Catheter(taper=(0.04, 0.01)), "two increasing distances"),
    (lambda: Catheter(marker_length=2.0), "marker of 2000 mm is longer than its catheter of 1000 mm"),
    (lambda: Catheter(shape=((0.0, 0.02, math.nan, 0.0),)), "shape.* must be a finite number"),
    (lambda: Catheter(shape=((0.0, 0.02, 1.0),)), "shape"),
    (lambda: Catheter(shape=((0.02, 0.02, 1.0, 0.0),)), "start nearer to the tip than it ends"),
    (lambda: Catheter(shape=((0.9, 1.1, 1.0, 0.0),)), "ends at 1100 mm lies beyond the catheter, which has 1000 mm"),
    (
        lambda: Catheter(shape=((0.0, 0.005, np.pi, 0.0),)),
        r"180 degrees from 0 mm to 5 mm has a radius of 0.79\d* mm, below",
    ),
    (lambda: Catheter(shape=((0.0, 0.03, 1.0, 0.0), (0.02, 0.05, 1.0, 0.0))), "overlap between 20 mm and 30 mm"),
    (lambda: Catheter(shape=((0.0, 0.06, 6.0, 0.0), (0.06, 0.12, 6.0, 0.0))), "runs through itself"),
    (lambda: Detector(photons=0), "photons must lie in"),
    (lambda: Detector(heel=2.0), "heel must lie in"),
    (lambda: Section(0.1, ((0.5e-3, 1.0), (0.3e-3, 1.0))), "growing positive radii"),
    (lambda: Section(0.0, ((0.5e-3, 1.0),)), "length must lie in"),
    (lambda: WireMaterial(()), "at least one section"),
    (lambda: XRayScene("", (), 0, 0, 0, 0, scatter=1.0), "scatter must lie in"),
    (lambda: XRayScene("", (), 0, 0, -1, 0, scatter=0.1), "wall_thickness must lie in"),
    (lambda: nodes([[0, 0, 9]], [1.0], (4, 4, 9)), r"within a lattice of \(4, 4, 9\) nodes"),
    (lambda: nodes([[0, 0, 0]], [1.0, 2.0], (4, 4, 4)), r"values must have shape \(1,\)"),
    (lambda: nodes([[0, 0]], [1.0], (4, 4, 4)), r"whole numbers of shape \(n, 3\)"),
    (lambda: nodes([[0, 0, 0]], [1.0], (4, 0, 4)), "at least one each"),
    (lambda: vessel(np.ones((2, 5, 5)), UP), "at least 3 x 3 x 3 nodes, got shape \\(2, 5, 5\\)"),
    (lambda: vessel(np.ones((5, 5, 5)), 2 * UP), "direction must be a unit vector"),
    (lambda: walled("accurate", 5.0), "resolves walls of at most 1 N/mm, got wall_stiffness 5"),
    (lambda: walled("reference", 0.0), "wall_stiffness must lie in 0.1 to 100 N/mm, got 0"),
    (lambda: walled("reference", float("nan")), "wall_stiffness must be a finite number"),
    (
        lambda: DevicePair(load_guidewire("default"), load_catheter("vertebral"), reach=1.4),
        "longer than the shorter device",
    ),
    (
        lambda: navigate(observation="mask_catheter", cameras="guide3d", image_size=64),
        "the mask of a catheter needs a catheter",
    ),
    (
        lambda: navigate(observation="mask_catheter_a", cameras="guide3d", image_size=64),
        "the mask of a catheter needs a catheter",
    ),
    (lambda: navigate(pace="slow"), "unknown pace 'slow'"),
    (lambda: Pace(translation=35), r"translation must lie in .* m, got 35"),
    (lambda: ExpertSettings(elites=30), "elites must lie in 1 to samples"),
    (lambda: ExpertSettings(horizon=2), "hold and execute must lie in 1 to the horizon"),
    (lambda: SamplingExpert(navigate(actions="tip_motors")), "steers the actions of the feeders"),
    (lambda: navigate(observation="image_a"), "pass cameras="),
    (lambda: navigate(observation="image_left", cameras="guide3d", image_size=32), "the cameras give image_a, mask_a"),
    (lambda: navigate(cameras="x-wing", image_size=32), "unknown geometry"),
    (lambda: ArchVarietyEnv(("III",)), r"arch_types must list some of .*got \('III',\)"),
    (lambda: ArchVarietyEnv(seeds=()), "phantoms must list at least one"),
    (lambda: ArchVarietyEnv(targets=("lcca",)), "leave targets out"),
    (lambda: RandomTreesEnv(targets=("lcca",)), "leave targets out"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_it_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_closed_environment_says_so() -> None:
    environment = NavigateEnv(arch())
    environment.close()
    for use in (environment.reset, lambda: environment.step(np.zeros(2))):
        with pytest.raises(RuntimeError, match="the environment is closed"):
            use()


def test_a_task_with_further_fields_keeps_what_it_was_given() -> None:
    task = Longer(target=np.array([0.1, 0.2, 0.3]), max_steps=np.int64(7), weight=3.0)
    assert (task.target, task.max_steps, task.weight) == ((0.1, 0.2, 0.3), 7, 3.0)
