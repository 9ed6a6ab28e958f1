"""The recurrent policy: what its network sees, how its controller holds actions, and the file that it is kept in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.imitation.recurrent_policy import RecurrentController, RecurrentPolicy, RecurrentPolicySettings
from enn.model_file import write_model

SETTINGS = RecurrentPolicySettings(
    features=10, encoder_blocks=((1, 3), (6, 3)), block_units=2, hidden=8, action_repeat=3
)


def scaled(settings: RecurrentPolicySettings = SETTINGS, seed: int = 1) -> RecurrentPolicy:
    """A policy whose features count as they are."""
    policy = RecurrentPolicy(settings, seed, perception={"cameras": ["a"]})
    policy.network.scale.fill_(1.0)
    return policy


def features(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (2, SETTINGS.features)).astype(np.float32)


def test_blocks_of_encoder_outputs_are_reduced_alike_and_all_else_is_seen() -> None:
    network = scaled().network
    assert network.inner[0].in_features == 10 - 2 * (3 - 2)
    swapped = torch.tensor([[0.0, 1, 2, 3, 0, 0, 4, 5, 6, 0]])
    inputs = []
    network.inner.register_forward_pre_hook(lambda module, given: inputs.append(given[0]))
    network(swapped[None])
    network(swapped[:, [0, 6, 7, 8, 4, 5, 1, 2, 3, 9]][None])
    one, other = (given[0, 0] for given in inputs)
    assert torch.equal(one[1:3], other[5:7])  # the same layer reduces both blocks
    assert torch.equal(one[5:7], other[1:3])
    assert torch.equal(one[[0, 3, 4, 7]], torch.zeros(4))


def test_the_state_remembers_and_the_seed_decides() -> None:
    policy = scaled()
    first, state = policy.act(features())
    second, _ = policy.act(features(), state)
    assert first.shape == (2, 2)
    assert (np.abs(first) <= 1).all()
    assert (first != second).any()  # the features are the same, what came before is not
    np.testing.assert_array_equal(first, scaled().act(features())[0])
    assert (first != scaled(seed=2).act(features())[0]).any()


class Counting:
    """A perception whose features are the number of decisions so far, and the last action."""

    def __call__(self, views: Sequence[list[int]], observations: Sequence[Any], actions: Sequence[Any]) -> np.ndarray:
        rows = np.zeros((len(views), SETTINGS.features), np.float32)
        for row, view, action in zip(rows, views, actions, strict=True):
            view.append(len(view))
            row[0], row[-2:] = len(view), action
        return rows


def test_controller_asks_once_a_decision_and_forgets_between_episodes() -> None:
    views: list[list[int]] = []

    def begin(observation: Any) -> list[int]:
        views.append([])
        return views[-1]

    steer = RecurrentController(scaled(), Counting(), begin)
    actions = np.array([steer({}) for _ in range(7)])
    assert len(views[0]) == 3
    np.testing.assert_array_equal(actions[0], actions[2])
    assert (actions[2] != actions[3]).any()
    steer.reset()
    np.testing.assert_array_equal([steer({}) for _ in range(7)], actions)
    assert len(views) == 2


def test_file_keeps_policy_perception_and_metadata(tmp_path: Path) -> None:
    policy = scaled()
    policy.save(tmp_path / "policy.pt", episodes=4)
    back = RecurrentPolicy.load(tmp_path / "policy.pt")
    assert (back.settings, back.perception, back.metadata) == (SETTINGS, {"cameras": ["a"]}, {"episodes": 4})
    np.testing.assert_array_equal(back.act(features())[0], policy.act(features())[0])


def test_says_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no recurrent policy"):
        RecurrentPolicy.load(tmp_path / "none.pt")
    (tmp_path / "broken.pt").write_bytes(b"no file of torch")
    with pytest.raises(ValueError, match="is damaged or no recurrent policy"):
        RecurrentPolicy.load(tmp_path / "broken.pt")
    write_model(tmp_path / "other.pt", {"format": "something else"})
    with pytest.raises(ValueError, match="is no recurrent policy of format"):
        RecurrentPolicy.load(tmp_path / "other.pt")
    for blocks in (((0, 3), (2, 3)), ((0, 3), (4, 2)), ((8, 3),)):
        with pytest.raises(ValueError, match="encoder_blocks: expected blocks of one length"):
            replace(SETTINGS, encoder_blocks=blocks)
