"""Environments in checkpoints: what the simulator says of its state is plain data, and it goes on from it exactly."""

from typing import Any

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.contact.breathing import Breathing
from cathsim.observations.observables import OBSERVABLES
from enn.model_file import decoded, encoded
from enn.reinforcement.checkpoint import plain, restored
from tests.cathsim.equal_observations import same

VARIANTS: dict[str, dict[str, Any]] = {
    "everything seen": {
        "observation": OBSERVABLES, "image_size": 32, "reward": "geodesic", "start_rotation": 2.0,
        "registration_noise": 1e-3,
    },
    "cameras": {"observation": ("image_a", "mask_a", "image_b"), "cameras": "guide3d", "image_size": 32},
    "robot": {"observation": ("feeder", "shape"), "drive": "robot"},
    "blood and breathing": {"observation": "joints", "blood": "steady", "breathing": Breathing()},
}  # fmt: skip


@pytest.mark.parametrize("kind", VARIANTS)
def test_an_environment_goes_on_from_a_file(kind: str) -> None:
    first, second = (NavigateEnv(**VARIANTS[kind], accuracy="fast") for _ in range(2))
    drawn = np.random.default_rng(0).uniform(-0.2, 1, (50, *first.action_space.shape))
    actions = drawn.astype(np.float32)
    first.reset(seed=3)
    for action in actions[:35]:
        first.step(action)
    saved = restored(decoded(encoded(plain(first.state()))))
    second.reset(seed=9)
    second.restore(saved)
    assert same(first.simulation.blood_forces(), second.simulation.blood_forces())
    for action in actions[35:]:
        assert same(first.step(action), second.step(action))
    first.close()
    second.close()
