"""The catheter: stiffness profile, unloaded shape, and the refusal of shapes that no tube has."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from cathsim.devices.catheter import RAMP, Catheter

HOOK = (0.010, 0.060, np.radians(150.0), 0.0)  # radius of about 18 mm


def integral(catheter: Catheter, samples: int = 40_001) -> complex:
    distance = np.linspace(0.0, catheter.length, samples)
    return complex(np.trapezoid(catheter.rest_curvature(distance), distance))


def test_stiffness_is_that_of_tip_and_shaft_and_geometric_between() -> None:
    catheter = Catheter(shaft_stiffness_nmm2=300.0, tip_stiffness_nmm2=75.0, taper=(0.01, 0.04))
    np.testing.assert_allclose(
        catheter.stiffness(np.array([0.0, 0.01, 0.025, 0.04, 0.9])) * 1e6, [75, 75, 150, 300, 300]
    )
    assert type(catheter.stiffness(0.025)) is float
    assert catheter.torsional_stiffness(0.5) == pytest.approx(catheter.torsional_stiffness_nmm2 * 1e-6)
    ratio = catheter.torsional_stiffness(np.array([0.0, 0.5])) / catheter.stiffness(np.array([0.0, 0.5]))
    assert ratio[0] == pytest.approx(ratio[1])


@pytest.mark.parametrize(
    "bend", [HOOK, (0.0, 0.004, np.radians(30.0), 0.0), (0.0, 0.012, np.radians(-40.0), 1.0), (0.02, 0.2, 3.0, -2.0)]
)
def test_curvature_integrates_to_the_bends_angle(bend: tuple[float, float, float, float]) -> None:
    assert integral(Catheter(shape=(bend,))) == pytest.approx(bend[2] * np.exp(1j * bend[3]), rel=1e-5)


def test_curvature_rises_over_the_ramp_without_a_step() -> None:
    catheter = Catheter(shape=(HOOK,))
    distance = np.linspace(0.0, 0.08, 8001)
    curvature = catheter.rest_curvature(distance).real
    assert curvature[distance <= HOOK[0]].max() == curvature[distance >= HOOK[1]].max() == 0
    top = HOOK[2] / (HOOK[1] - HOOK[0] - RAMP)
    assert curvature.max() == pytest.approx(top)
    # the steepest place of a raised cosine
    assert np.abs(np.diff(curvature)).max() <= 1.001 * top * np.pi / 2 / RAMP * 1e-5


def test_curvature_takes_a_number_and_is_nothing_beyond_the_ends() -> None:
    catheter = Catheter(length=0.1, shape=((0.0, 0.1, 1.0, 0.5),))
    assert type(catheter.rest_curvature(0.05)) is complex
    assert catheter.rest_curvature(0.05) == catheter.rest_curvature(np.array([0.05]))[0]
    assert catheter.rest_curvature(-0.001) == catheter.rest_curvature(0.101) == 0


def test_centreline_turns_by_the_angle_towards_minus_y() -> None:
    catheter = Catheter(length=0.3, shape=((0.0, 0.03, np.pi / 2, 0.0),))
    points = catheter.centreline(np.linspace(0.0, 0.1, 1001))
    np.testing.assert_allclose(points[-1], 0)
    np.testing.assert_allclose(points[500], [0, 0, 0.05], atol=1e-9)
    last = points[0] - points[1]
    np.testing.assert_allclose(last / np.linalg.norm(last), [0, -1, 0], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 1e-4)


def test_plane_turns_the_bend_about_the_axis() -> None:
    distance = np.linspace(0.0, 0.1, 501)
    flat, turned = (
        Catheter(shape=((0.0, 0.03, 1.0, plane),)).centreline(distance) for plane in (0.0, np.radians(30.0))
    )
    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    np.testing.assert_allclose(turned, flat @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T, atol=1e-12)


def test_centreline_of_a_bend_agrees_with_the_guidewires_hinges() -> None:
    """The angle that turns a guidewire's tip turns a catheter's in the same direction, also about y."""
    mujoco = pytest.importorskip("mujoco")
    from cathsim.guidewire import TIP_SITE, Guidewire

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    wire = Guidewire(links=(0.002,) * 30, tip_angle=np.radians(60.0), tip_length=0.02)
    wire.add_to(spec.worldbody.add_body(name="clamp"), clamped=True)
    model = spec.compile()
    data = mujoco.MjData(model)
    for part, plane in (("x", 0.0), ("y", np.pi / 2)):
        data.qpos[:] = 0
        for joint in range(model.njnt):
            if model.joint(joint).name.endswith(part):
                data.qpos[joint] = model.qpos_spring[joint if part == "x" else joint - 1]
        mujoco.mj_kinematics(model, data)
        catheter = Catheter(length=0.06, shape=((0.001, 0.021, np.radians(60.0), plane),))
        tip = catheter.centreline(np.linspace(0.0, 0.06, 601))[0]
        np.testing.assert_allclose(data.site(TIP_SITE).xpos, tip, atol=4e-4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inner_diameter": 2e-3}, r"inner diameter .*2 mm.* smaller than its outer one .*1.67 mm"),
        ({"outer_diameter": 1.67}, "outer_diameter must lie in .* m, got 1.67; lengths are in metres"),
        ({"taper": (0.04, 0.01)}, "two increasing distances"),
        ({"marker_length": 2.0}, "marker of 2000 mm is longer than its catheter of 1000 mm"),
        ({"shape": ((0.0, 0.02, math.nan, 0.0),)}, "shape.* must be a finite number"),
        ({"shape": ((0.0, 0.02, 1.0),)}, "shape"),
        ({"shape": ((0.02, 0.02, 1.0, 0.0),)}, "start nearer to the tip than it ends"),
        ({"shape": ((0.9, 1.1, 1.0, 0.0),)}, "ends at 1100 mm lies beyond the catheter, which has 1000 mm"),
        ({"shape": ((0.0, 0.005, np.pi, 0.0),)}, r"180 degrees from 0 mm to 5 mm has a radius of 0.79\d* mm, below"),
        ({"shape": ((0.0, 0.03, 1.0, 0.0), (0.02, 0.05, 1.0, 0.0))}, "overlap between 20 mm and 30 mm"),
        ({"shape": ((0.0, 0.06, 6.0, 0.0), (0.06, 0.12, 6.0, 0.0))}, "runs through itself"),
        ({"shape": ((0.020, 0.060, np.radians(300.0), 0.0),)}, "runs through itself"),
        ({"torsional_stiffness_nmm2": 0.0}, "torsional_stiffness_nmm2 must lie in"),
    ],
)
def test_what_no_catheter_has_is_refused_in_one_sentence(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        Catheter(**changes)
    assert "\n" not in str(caught.value)


def test_a_pigtails_loop_is_a_shape() -> None:
    loop = ((0.0, 0.012, np.radians(180.0), 0.0), (0.012, 0.030, np.radians(180.0), 0.0))
    assert integral(Catheter(shape=loop)) == pytest.approx(2 * np.pi, rel=1e-5)
