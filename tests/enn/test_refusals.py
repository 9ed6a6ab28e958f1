"""What cannot be is refused in a sentence that says what there is."""

import dataclasses
from collections.abc import Callable

import gymnasium
import numpy as np
import pytest

from enn.exploration import scripted_samples
from enn.imitation.behaviour_cloning import BehaviourCloningSettings
from enn.imitation.cloned_policy import CloningNetworkSettings
from enn.imitation.path_following import PathFollowerSettings, PlannedPath, fit_path_follower
from enn.networks.network import NetworkSettings, build_network
from enn.networks.observation_spaces import modality_keys
from enn.reinforcement.rehearsal import cases_of
from enn.reinforcement.start_state_buffer import CaseStartStateBuffer, StartStateBuffer
from enn.reinforcement.training.settings import PpoSettings
from enn.retrying import RetryingController
from tests.enn.rod import Rod

ACTIONS = gymnasium.spaces.Box(-1, 1, (2,), np.float32)
IMAGES = gymnasium.spaces.Dict({"image": gymnasium.spaces.Box(0, 255, (1, 8, 8), np.uint8)})


def uneven() -> None:
    three = scripted_samples(Rod, 3, seed=0)
    dataclasses.replace(three, direction=three.direction[:2])


def filled() -> StartStateBuffer:
    buffer = StartStateBuffer()
    buffer.add_episode(np.zeros((2, 3)))
    return buffer


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: scripted_samples(lambda: Rod(("image",)), 10, seed=0), "shape, feeder, force is missing: add it"),
    (lambda: scripted_samples(Rod, 0, seed=0), "count must be at least 1, got 0"),
    (uneven, "expected 3 rows in every array, got direction 2"),
    (lambda: BehaviourCloningSettings(l2=-1.0), "l2 must be greater than or equal to 0, got -1"),
    (lambda: CloningNetworkSettings(keys=("joints",)), "a cloned policy sees some of image"),
    (lambda: PlannedPath([[0, 0, 0]]), r"shape \(n, 3\) with n >= 2, got shape \(1, 3\)"),
    (lambda: PlannedPath([[0, 0, 0], [0, 0, 0]]), "length above nought"),
    (lambda: fit_path_follower([], [], PathFollowerSettings()), "a path for each of at least one episode"),
    (lambda: modality_keys("M+V"), r"I, V, M, I\+V, I\+M, V\+M, I\+V\+M, R, internal, image, sequential"),
    *(
        (lambda n=n: NetworkSettings(**{n: "other"}), f"unknown {n} 'other'; there are")
        for n in ("variant", "algorithm")
    ),
    (lambda: NetworkSettings(algorithm="ppo", critic_layer_norm=True), "leave critic_layer_norm out with ppo"),
    (lambda: build_network(NetworkSettings(), IMAGES, ACTIONS), "image is an image: give it an encoder, or a network"),
    (lambda: cases_of(gymnasium.make("CartPole-v1")), "a rehearsal needs an environment with cases"),
    (
        lambda: CaseStartStateBuffer(3).add_episode(np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 1.0]])),
        "an episode stays in one case, got states of 2",
    ),
    (lambda: RetryingController(lambda seed: None, 0, None), "1 step at least, got None with 0"),
    (lambda: StartStateBuffer(share=1.5), r"between 0 and 1, got 1\.5"),
    (lambda: StartStateBuffer(capacity=0), "capacity must be at least 1"),
    (lambda: filled().add_episode(np.zeros((2, 4))), r"keeps states of 3 values, got 4.*another wire"),
    (lambda: filled().add_episode(np.zeros(3)), r"shape \(T, n\)"),
    (lambda: filled().add_episode(np.full((1, 3), np.nan)), "finite"),
    (lambda: StartStateBuffer(capacity=1).restore(filled().state()), "holds 2 states, more than the capacity of 1"),
    (lambda: PpoSettings(log_std_final=-2.5, ent_coef=0.01), r"log_std_final settles the entropy.*got 0\.01"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_it_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
