"""Learning from an expert that advises: DAgger, advised episodes, distillation, disturbed controllers."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest

from enn.fitting import EpisodeFitSettings
from enn.imitation.behaviour_cloning import DESK_CLONING
from enn.imitation.dagger import DaggerSettings, DisturbanceSettings, Disturbed, dagger, record
from enn.imitation.distillation import DISTURBED_SEEDS, distil
from enn.imitation.images.egocentric import VIEW_SIZE
from enn.trajectory import Trajectory
from tests.enn.imitation.drawn_point import DrawnPoint, expert
from tests.enn.imitation.straight_wire import advised, policy_on, untrained

QUICK = replace(DESK_CLONING, fit=EpisodeFitSettings(epochs=6, batch_size=32, learning_rate=3e-3))


def test_rounds_aggregate_and_the_student_improves() -> None:
    environment = DrawnPoint()
    first = [record(environment, expert, seed=seed, keys=("image",)) for seed in range(4)]
    settings = DaggerSettings(rounds=3, episodes=12)
    student, rounds, everything = dagger(DrawnPoint, expert, first, settings, QUICK)
    assert [told.episodes for told in rounds] == [16, 28, 40]
    assert len(everything) == 40
    assert rounds[-1].disagreement < rounds[0].disagreement
    reached = [record(environment, student.controller(), seed=500 + k, keys=()).terminated for k in range(20)]
    assert np.mean(reached) >= 0.9


def test_disturbance_is_seeded_and_spells_push() -> None:
    def ways(seed: int) -> np.ndarray:
        size = DisturbanceSettings(noise=0.1, spell_chance=0.3, push=5.0)
        disturbed = Disturbed(expert, np.random.default_rng(seed), size)
        return record(DrawnPoint(), disturbed, seed=2, keys=(), labels=expert).tips

    np.testing.assert_array_equal(ways(1), ways(1))
    assert ways(1).shape != ways(2).shape or not np.array_equal(ways(1), ways(2))
    always = Disturbed(expert, np.random.default_rng(0), DisturbanceSettings(spell_chance=1.0, spell_steps=1, push=5.0))
    assert always({"place": np.array([9.0, 9.0])}, {})[0] == 1.0  # the expert would go the other way
    pressed = DisturbanceSettings(spell_chance=1.0, spell_steps=1, push=5.0)
    pair = Disturbed(lambda observation, info: np.zeros(4), np.random.default_rng(0), pressed)({}, {})
    assert pair[[0, 2]].tolist() == [1.0, 1.0]  # wire and catheter; their rotations are drawn as before
    assert (np.abs(pair[[1, 3]]) < 1.0).all()


def test_teacher_and_policy_steer_and_the_teacher_advises() -> None:
    perception = untrained()
    policy = policy_on(perception)
    by_teacher, by_policy = advised(policy, perception, 1.0, 1), advised(policy, perception, 0.0, 2, 8)
    assert all(one.success for one in by_teacher)
    assert not any(one.success for one in by_policy)
    for one in (*by_teacher, *by_policy):
        np.testing.assert_allclose(one.actions[:, 0], np.clip(5 * one.hints[:, 0], -1, 1))  # advice, without noise
        assert one.features.shape == (len(one.hints), VIEW_SIZE)
        assert one.target == "dot"


DISTILLATION_QUICK = replace(DESK_CLONING, fit=EpisodeFitSettings(epochs=1, batch_size=32))


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
        PlaceExpert(), episodes, DISTILLATION_QUICK, make_environment, disturbed_seeds=(7, 8), rounds=rounds, seed=1,
        progress=lambda share, words: told.append((share, words)),
    )  # fmt: skip
    assert full.episodes == 3 + 2 + 2
    assert [one.episodes for one in full.rounds] == [6, 7]
    assert full.samples > sum(map(len, episodes))
    assert [round(share, 3) for share, _ in told] == [0.333, 0.667, 1.0]


def test_disturbed_episodes_are_the_default_and_features_are_matched_only_where_the_expert_could_see(
    episodes: list[Trajectory],
) -> None:
    usual = distil(PlaceExpert(), episodes, DISTILLATION_QUICK, make_environment)
    assert usual.episodes == 3 + len(DISTURBED_SEEDS)
    alone = [replace(one, observations={"image": one.observations["image"]}) for one in episodes]
    for given, settings, features in (
        (episodes, DISTILLATION_QUICK, 2),
        (alone, DISTILLATION_QUICK, 0),
        (episodes, replace(DISTILLATION_QUICK, feature_matching=0.0), 0),
    ):
        plain = distil(PlaceExpert(), given, settings, make_environment, disturbed_seeds=())
        assert plain.episodes == 3
        assert plain.student.network.settings.expert_features == features
