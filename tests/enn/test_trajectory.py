"""Trajectory: invariants, and episodes laid end to end."""

from typing import Any

import numpy as np
import pytest

from enn.trajectory import Trajectory, join, require_same_shapes


def arrays(steps: int = 4, side: int = 8) -> dict[str, Any]:
    generator = np.random.default_rng(steps)
    return {
        "observations": {
            "image": generator.integers(0, 255, (steps + 1, 1, side, side), np.uint8),
            "joints": generator.normal(size=(steps + 1, 6)).astype(np.float32),
        },
        "actions": generator.uniform(-1, 1, (steps, 2)).astype(np.float32),
        "rewards": generator.normal(size=steps),
        "terminated": True,
        "forces": generator.uniform(0, 1, steps),
        "tips": generator.normal(size=(steps + 1, 3)),
        "simulation_states": generator.normal(size=(steps + 1, 5)),
        "metadata": {"file": f"{steps}.mcap"},
    }


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("actions", np.zeros((0, 2)), r"actions must have shape \(T, a\) with T >= 1, got \(0, 2\)"),
        ("rewards", np.zeros(5), r"rewards of 4 actions must have shape \(4,\), got \(5,\)"),
        ("forces", np.zeros(3), r"forces of 4 actions must have shape \(4,\), got \(3,\)"),
        ("forces", np.array([0, 0, -1.0, 0]), "cannot be negative"),
        ("tips", np.zeros((4, 3)), r"tips of 4 actions must have shape \(5, 3\), got \(4, 3\)"),
        ("simulation_states", np.zeros((4, 9)), r"must have shape \(5, n\), got \(4, 9\)"),
        ("observations", {"joints": np.zeros((4, 6))}, "'joints' of 4 actions needs 5 entries, got 4"),
        ("observations", {"joints": np.full((5, 6), np.nan)}, "'joints' is not finite at step 0"),
        ("rewards", np.array([0, 0, np.inf, 0]), "'rewards' is not finite at step 2"),
    ],
)
def test_refuses_what_does_not_fit(name: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Trajectory(**(arrays() | {name: value}))


def test_join_leaves_the_last_moment_of_each_episode_out() -> None:
    first, second = Trajectory(**arrays(3)), Trajectory(**arrays(5))
    seen, actions, forces = join([first, second], ("joints",))
    assert list(seen) == ["joints"]
    np.testing.assert_array_equal(seen["joints"][:3], first.observations["joints"][:3])
    np.testing.assert_array_equal(seen["joints"][3:], second.observations["joints"][:5])
    assert actions.shape == (8, 2)
    np.testing.assert_allclose(forces[3:], second.forces, rtol=1e-6)


def test_names_the_episode_of_another_image_size_wire_or_action() -> None:
    with pytest.raises(ValueError, match=r"5.mcap was recorded with another image size: its 'image' has shape \(1, 9"):
        require_same_shapes([Trajectory(**arrays(4)), Trajectory(**arrays(5, side=9))], ("image",))
    other = arrays(5)
    other["observations"]["joints"] = np.zeros((6, 8), np.float32)
    with pytest.raises(ValueError, match=r"5.mcap was recorded with another wire: its 'joints' has shape \(8,\)"):
        require_same_shapes([Trajectory(**arrays(4)), Trajectory(**other)], ("joints",))
    with pytest.raises(ValueError, match=r"5.mcap has 21 actions, the other episodes 2"):
        join([Trajectory(**arrays(4)), Trajectory(**(arrays(5) | {"actions": np.zeros((5, 21))}))], ("image",))
