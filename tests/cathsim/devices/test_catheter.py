"""The catheter: stiffness profile, unloaded shape, and the refusal of shapes that no tube has."""

import math
from typing import Any

import numpy as np
import pytest

from cathsim.devices.catheter import Catheter


def test_stiffness_is_that_of_tip_and_shaft_and_geometric_between() -> None:
    catheter = Catheter(shaft_stiffness_nmm2=300.0, tip_stiffness_nmm2=75.0, taper=(0.01, 0.04))
    np.testing.assert_allclose(
        catheter.stiffness(np.array([0.0, 0.01, 0.025, 0.04, 0.9])) * 1e6, [75, 75, 150, 300, 300]
    )
    assert type(catheter.stiffness(0.025)) is float
    assert catheter.torsional_stiffness(0.5) == pytest.approx(catheter.torsional_stiffness_nmm2 * 1e-6)
    ratio = catheter.torsional_stiffness(np.array([0.0, 0.5])) / catheter.stiffness(np.array([0.0, 0.5]))
    assert ratio[0] == pytest.approx(ratio[1])


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
