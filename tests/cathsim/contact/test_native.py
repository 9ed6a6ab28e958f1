"""Contact by signed distance: forces, neighbours left alone, layout, NaN, threads."""

import json
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
import pytest

from cathsim.anatomy import ArchParameters, Branch, Entry, Phantom, VesselTree
from cathsim.contact import native
from cathsim.contact.sdf import Vessel
from cathsim.devices.arena import model_spec
from cathsim.guidewire import Guidewire, load_guidewire
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation
from tests.cathsim.drawn_vessels import UP, sampled, sphere, tube


@pytest.fixture(scope="module")
def fed_tube() -> Vessel:
    """A tube with a sheath."""
    return tube(sheath_radius=0.75e-3)


def wire_in(vessel: Vessel) -> mujoco.MjModel:
    return model_spec(vessel, load_guidewire("default"), ACCURACY["accurate"]).compile()


def pushed(model: mujoco.MjModel, steps: int, advance: float = 0.04) -> mujoco.MjData:
    """A wire that is fed at constant speed."""
    data = mujoco.MjData(model)
    for i in range(steps):
        data.ctrl[0] = advance * (i + 1) / steps
        mujoco.mj_step(model, data)
    return data


@pytest.fixture(scope="module")
def tube_phantom() -> Phantom:
    """A straight tube with an entry at its lower end; the simulation needs no more of a phantom than that."""
    vessel = tube()
    entry = Entry("descending", np.zeros(3), UP)
    axis = np.outer(np.linspace(0.0, 0.1, 11), UP)
    tree = VesselTree((Branch("aorta", axis, np.full(11, 0.005)),))
    return Phantom("tube", "0" * 16, ArchParameters(), tree, vessel.grid, {}, {"descending": entry})


@pytest.mark.parametrize("push", [0.02, 0.5])
def test_wall_balances_the_force_that_presses_a_wire_on_it(push: float) -> None:
    """A stiff wire that slides towards a plane wall along x rests there on contact forces that add up to the push."""
    vessel = sampled(lambda p: p[:, 0] + 0.002, -0.010, 0.030, 0.001)
    spec = mujoco.MjSpec()
    spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_DISCRETE, 0.002
    spec.option.cone, spec.option.gravity = mujoco.mjtCone.mjCONE_ELLIPTIC, [0, 0, 0]
    vessel.add_to(spec)
    slide = spec.worldbody.add_body(name="slide")
    slide.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0], damping=[0.05, 0, 0])
    wire = load_guidewire("default", links=(0.008,) * 2, tip_angle=0.0, tip_length=0.0)
    wire.add_to(slide, mass_scale=10.0)
    motor = spec.add_actuator(name="push", target="slide", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_motor()
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = -push
    mujoco.mj_step(model, data, nstep=1500)
    assert np.abs(data.qvel).max() < 1e-6
    mujoco.mj_forward(model, data)
    total, wrench = np.zeros(3), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, wrench)
        total -= data.contact.frame[i].reshape(3, 3).T @ wrench[:3]
        np.testing.assert_allclose(data.contact.frame[i, :3], [-1, 0, 0], atol=1e-5)
    np.testing.assert_allclose(total, [push, 0, 0], atol=0.01 * push)
    # it lies on the wall: axis a radius from it, less a small penetration
    assert data.qpos[0] == pytest.approx(-0.002 + wire.radius, abs=1e-4)


BOXES = """
<mujoco><size nuser_geom="2"/><option timestep="0.004"/><worldbody><geom type="plane" size="1 1 .1"/>
<geom type="box" size=".1 .1 .05" pos="0 0 .05" user="7 0"/>
<geom type="ellipsoid" size=".1 .08 .05" pos=".3 0 .05"/>
<body pos=".02 .01 .3" euler="30 20 10"><freejoint/><geom type="capsule" size=".02 .06"/></body>
<body pos=".3 .01 .3" euler="70 20 10"><freejoint/><geom type="capsule" size=".02 .06"/></body>
<body pos="-.05 0 .2" euler="10 0 5"><freejoint/><geom type="box" size=".04 .03 .02"/></body>
<body pos=".33 0 .22"><freejoint/><geom type="ellipsoid" size=".03 .04 .02"/></body></worldbody></mujoco>
"""
WATCH = """
def watch(mujoco, xml):
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    seen = []
    for _ in range(400):
        mujoco.mj_step(model, data)
        contact = data.contact
        seen.append([contact.geom.tolist(), contact.dist.tolist(), contact.frame.tolist(), contact.pos.tolist()])
    return [seen, data.qpos.tolist()]
"""


def test_ordinary_boxes_and_ellipsoids_collide_as_in_plain_mujoco(
    run_python: Callable[[str], str], fed_tube: Vessel
) -> None:
    assert pushed(wire_in(fed_tube), 100).ncon > 0
    scope: dict[str, Any] = {}
    exec(WATCH, scope)
    here = scope["watch"](mujoco, BOXES)
    ending = f"import json, sys, mujoco\nprint(json.dumps([watch(mujoco, {BOXES!r}), 'cathsim' in sys.modules]))"
    plain, with_cathsim = json.loads(run_python(WATCH + ending))
    assert not with_cathsim
    assert here == plain
    pairs = {tuple(pair) for step in plain[0] for pair in step[0]}
    assert {(1, 3), (2, 4)} <= pairs | {(b, a) for a, b in pairs}, "capsules met neither the box nor the ellipsoid"


def test_vessels_of_one_process_do_not_mix() -> None:
    narrow, wide = sphere(0.006), sphere(0.012)
    assert narrow.number != wide.number
    outermost = []
    for vessel in (narrow, wide, narrow):
        spec = mujoco.MjSpec()
        # towards the capsule's distal end: the proximal one is left to the link before
        spec.option.gravity = [0.0, 0.0, 1.0]
        vessel.add_to(spec)
        body = spec.worldbody.add_body()
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.0005, 0.001, 0], contype=0, conaffinity=1)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, nstep=1000)
        outermost.append(np.linalg.norm(data.qpos[:3]))
    assert 0.004 < outermost[0] < 0.006
    assert 0.010 < outermost[1] < 0.012
    assert outermost[0] == outermost[2]


@pytest.mark.parametrize(
    ("place", "part"),
    [
        ((0.0005, 0.0, -0.020), "sheath"),
        ((-0.0058, 0.0, -0.020), "vessel"),
        ((0.0158, 0.0, -0.020), "vessel"),  # behind the sheath's end, where the vessel has turned back beside it
    ],
)
def test_wall_beside_the_sheath_is_the_vessels(place: tuple[float, float, float], part: str) -> None:
    """A U of two tubes side by side: the wire comes in at the middle of one and lies at the wall of the other."""

    def distance(p: np.ndarray) -> np.ndarray:
        return 0.006 - np.minimum(np.hypot(p[:, 0], p[:, 1]), np.hypot(p[:, 0] - 0.010, p[:, 1]))

    vessel = sampled(distance, -0.030, 0.030, 0.001, sheath_radius=0.75e-3, sheath_amid=True)
    spec = mujoco.MjSpec()
    vessel.add_to(spec)
    link = spec.worldbody.add_body(name="link", pos=place)
    link.add_freejoint()
    link.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.4e-3, 2e-3, 0], contype=0, conaffinity=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    walls = {int(geom) for geom in data.contact.geom.ravel()} - {model.ngeom - 1}
    assert {model.geom(wall).name for wall in walls} == {part}


@pytest.mark.parametrize("field", [native.LAYOUT_FIELDS[0], native.LAYOUT_FIELDS[-1]])
def test_a_shifted_field_is_detected(field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    right = native.layout_expected

    def shifted(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, int]:
        return {name: value + 8 * (name == field) for name, value in right(model, data).items()}

    monkeypatch.setattr(native, "layout_expected", shifted)
    with pytest.raises(ImportError, match=f"disagree on {field}: reinstall"):
        native.library.__wrapped__()


def test_another_version_of_mujoco_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco, "mj_version", lambda: 3_017_000)
    with pytest.raises(ImportError, match=r"was built for MuJoCo .* and 3017000 is running"):
        native.library.__wrapped__()


NAN_STATE = """
import mujoco, numpy as np
from cathsim import ACCURACY, load_guidewire
from cathsim.anatomy import SignedDistanceGrid
from cathsim.devices.arena import model_spec
from cathsim.contact.sdf import Vessel
grid = SignedDistanceGrid(np.ones((9, 9, 9)), np.zeros(3), 1e-3)
vessel = Vessel(grid, np.zeros(3), np.array([0.0, 0.0, 1.0]))
vessel.distance(np.full((1, 3), np.nan))
model = model_spec(vessel, load_guidewire("default"), ACCURACY["accurate"]).compile()
data = mujoco.MjData(model)
data.qpos[5] = np.nan
mujoco.mj_step(model, data, nstep=3)
print("alive", data.warning[mujoco.mjtWarning.mjWARN_BADQPOS].number > 0)
"""


def test_nan_positions_do_not_end_the_process(run_python: Callable[[str], str]) -> None:
    """An unstable state is reported by MuJoCo's warnings; it must not make an index out of NaN."""
    assert "alive True" in run_python(NAN_STATE)


def drive(simulation: Simulation, seed: int) -> bytes:
    """Bytes of everything a random episode of 60 control steps goes through."""
    rng = np.random.default_rng(seed)
    simulation.reset()
    trace, touched = [], 0
    for _ in range(60):
        simulation.advance(rng.uniform(0.0, 0.002), rng.uniform(-0.26, 0.26))
        trace += [simulation.state(), simulation.force(), simulation.contacts().forces.ravel()]
        touched += simulation.summary.contacts
    assert simulation.valid
    assert touched > 60, "the wire hardly met the wall"
    return np.concatenate(trace).tobytes()


def test_threads_do_not_change_a_bit(tube_phantom: Phantom) -> None:
    """Two simulations in one vessel, in turn and at once."""
    wires = [Guidewire(), load_guidewire("radifocus_angled")]
    points = np.random.default_rng(5).uniform(-0.01, 0.01, (2, 100_000, 3))
    start = threading.Barrier(2)

    def run(index: int, wait: bool) -> bytes:
        simulation = Simulation(tube_phantom, wires[index], ACCURACY["accurate"])
        if wait:
            start.wait()
        return simulation.vessel.distance(points[index])[0].tobytes() + drive(simulation, index)

    apart = [run(0, False), run(1, False)]
    for _ in range(2):
        with ThreadPoolExecutor(2) as pool:
            assert list(pool.map(run, range(2), [True] * 2)) == apart
