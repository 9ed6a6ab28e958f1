"""Two devices in the dm_control environment: agreement with the Gymnasium one, starts, observations, bad input."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cathsim import Accuracy, NavigateEnv
from cathsim.devices.shelf import load_catheter
from cathsim.simulation import LEAD_ADVANCE

pytest.importorskip("dm_control")

from cathsim import composer

MakeEnv = Callable[..., NavigateEnv]
TIP = "feeder/guidewire/tip"
FINE = Accuracy(timestep=0.001, refinement=1, mass_scale=10.0)
QUICK = Accuracy(timestep=0.005, refinement=1, mass_scale=10.0)


def both(step: int) -> list[float]:
    return [1.0, 0.2, 1.0, 0.5]


def wire_first(step: int) -> list[float]:
    return [1.0, 0.0, 1.0 if step > 25 else 0.0, 0.0]


@pytest.mark.parametrize(
    ("catheter", "numerics", "motion"),
    [
        ("vertebral", composer.STEPPING, both),
        ("vertebral", composer.STEPPING, wire_first),
        ("simmons2", FINE, wire_first),
        ("simmons2", FINE, both),
    ],
)
def test_agrees_with_the_gymnasium_environment(
    make_env: MakeEnv, catheter: str, numerics: Accuracy, motion: Callable[[int], list[float]]
) -> None:
    arguments = {"catheter": catheter, "start_jitter": 0.0}
    other = make_env(accuracy="accurate", observation="devices", **arguments)
    env = composer.load(seed=0, numerics=numerics, **arguments)
    other.reset(seed=0)
    env.reset()
    apart = []
    for step in range(50):
        action = np.array(motion(step))
        seen, observation = env.step(action).observation, other.step(action)[0]
        apart.append(np.linalg.norm(seen[TIP] - other.simulation.tip))
    assert np.median(apart) < 1e-3
    assert max(apart) < 4e-3
    assert np.allclose(seen["devices"], observation[:, :2], atol=3e-4)
    env.close()


def test_where_the_drive_is_stuck_the_feeders_slip() -> None:
    env = composer.load(seed=0, numerics=QUICK, catheter="straight", start_jitter=0.0)
    env.reset()
    for _ in range(30):
        start = env.step(np.array([1.0, 0.0, 1.0, 0.0])).observation["devices"][:, 0]
    assert start.min() > 0.05
    env.physics.bind(env.task.feeder.joints[0]).damping = 1e6  # kg/s: it withstands the servo
    moved = np.array([env.step(np.array([1.0, 0.0, 0.0, 0.0])).observation["devices"][:, 0] for _ in range(20)]) - start
    assert np.abs(moved).max() < LEAD_ADVANCE + 1e-4  # 40 mm were asked for
    assert (np.ptp(moved[1:], axis=0) < 2e-4).all()  # neither wire nor catheter, once the servo's lead is used up
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"catheter": "simmons9"}, "unknown catheter 'simmons9'"),
        ({"catheter": load_catheter("straight", inner_diameter=0.8e-3)}, "a wire of 0.89 mm does not pass a catheter"),
        ({"catheter": "vertebral", "actions": "tip_motors"}, "without tip motors: leave out the catheter"),
        ({"catheter": "vertebral", "torsion": "soft"}, "unknown torsion 'soft'; there are elastic, rigid"),
        ({"wire": None}, "neither a wire nor a catheter is there"),
    ],
    ids=str,
)
def test_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        composer.load(**arguments)
