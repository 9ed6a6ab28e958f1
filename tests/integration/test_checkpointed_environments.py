"""Environments in checkpoints: what the simulator says of its state is plain data, and it goes on from it exactly."""

from typing import Any

import numpy as np
import pytest

from cathsim import NavigateEnv
from enn.model_file import decoded, encoded
from enn.reinforcement.checkpoint import plain, restored

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "geodesic": {"observation": ("roadmap", "history", "force"), "reward": "geodesic", "registration_noise": 1e-3},
    "cameras": {"observation": ("image_a", "mask_a", "image_b"), "cameras": "guide3d", "image_size": 32},
    "robot": {"observation": ("feeder", "shape"), "drive": "robot"},
}


@pytest.mark.parametrize("kind", VARIANTS)
def test_an_environment_goes_on_from_a_file(kind: str) -> None:
    first, second = (NavigateEnv(**VARIANTS[kind], accuracy="fast") for _ in range(2))
    drawn = np.random.default_rng(0).uniform(-0.2, 1, (12, *first.action_space.shape))
    actions = drawn.astype(np.float32)
    first.reset(seed=1)
    for action in actions[:6]:
        first.step(action)
    saved = restored(decoded(encoded(plain(first.state()))))
    second.reset(seed=5)
    second.restore(saved)
    for action in actions[6:]:
        one, other = first.step(action), second.step(action)
        seen, there = (step[0] if isinstance(step[0], dict) else {"": step[0]} for step in (one, other))
        assert all(np.array_equal(seen[name], there[name]) for name in seen)
        assert one[1:4] == other[1:4]
    first.close()
    second.close()
