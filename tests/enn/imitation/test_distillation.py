"""Distillation: what a student learns from beside the expert's episodes, and whether features are matched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest

from enn.fitting import EpisodeFitSettings
from enn.imitation.behaviour_cloning import DESK_CLONING
from enn.imitation.dagger import DaggerSettings, record
from enn.imitation.distillation import distil
from enn.trajectory import Trajectory
from tests.enn.imitation.drawn_point import DrawnPoint, expert

QUICK = replace(DESK_CLONING, fit=EpisodeFitSettings(epochs=1, batch_size=32))


class PlaceExpert:
    """Sees the place; its features are the place."""

    keys = ("place",)

    def act(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        return expert(observation, {})

    def features(self, observations: dict[str, np.ndarray]) -> np.ndarray:
        return observations["place"]


@pytest.fixture(scope="module")
def episodes() -> list[Trajectory]:
    return [record(DrawnPoint(), expert, seed=seed, keys=("image", "place")) for seed in range(3)]


def make_environment(keys: Sequence[str]) -> gymnasium.Env[Any, Any]:
    assert tuple(keys) == ("image", "place")
    return DrawnPoint()


def test_disturbed_episodes_and_rounds_add_to_what_is_learnt_from(episodes: list[Trajectory]) -> None:
    told: list[tuple[float, str]] = []
    rounds = DaggerSettings(rounds=2, episodes=1)
    full = distil(
        PlaceExpert(), episodes, QUICK, make_environment, disturbed_seeds=(7, 8), rounds=rounds, seed=1,
        progress=lambda share, words: told.append((share, words)),
    )  # fmt: skip
    assert full.episodes == 3 + 2 + 2
    assert [one.episodes for one in full.rounds] == [6, 7]
    assert full.samples > sum(map(len, episodes))
    assert [round(share, 3) for share, _ in told] == [0.333, 0.667, 1.0]
    assert told[0][1].startswith("epoch 1, loss ")
    assert told[2][1] == "DAgger round 2, epoch 1"


def test_features_are_matched_only_where_the_expert_could_see(episodes: list[Trajectory]) -> None:
    alone = [replace(one, observations={"image": one.observations["image"]}) for one in episodes]
    sizes = [
        distil(PlaceExpert(), given, settings, make_environment).student.network.settings.expert_features
        for given, settings in ((episodes, QUICK), (alone, QUICK), (episodes, replace(QUICK, feature_matching=0.0)))
    ]
    assert sizes == [2, 0, 0]


def test_a_plain_clone_is_that_of_the_episodes(episodes: list[Trajectory]) -> None:
    distilled = distil(PlaceExpert(), episodes, QUICK, make_environment)
    assert (distilled.episodes, distilled.samples, distilled.rounds) == (3, sum(map(len, episodes)), ())
    assert distilled.fit.rows[-1]["epoch"] == 1
