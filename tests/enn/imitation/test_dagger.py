"""DAgger: labels of the expert where the student goes, disturbed demonstrations, determinism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from enn.fitting import EpisodeFitSettings
from enn.imitation.behaviour_cloning import DESK_CLONING
from enn.imitation.dagger import DaggerSettings, DisturbanceSettings, Disturbed, dagger, record
from tests.enn.imitation.drawn_point import DrawnPoint, expert

QUICK = replace(DESK_CLONING, fit=EpisodeFitSettings(epochs=6, batch_size=32, learning_rate=3e-3))


def test_labels_are_the_experts_and_the_way_is_the_students() -> None:
    still = record(DrawnPoint(), lambda o, i: np.zeros(2), seed=1, keys=("place",), labels=expert)
    assert np.ptp(still.tips, axis=0).max() == 0
    np.testing.assert_allclose(still.actions[0], expert({"place": still.observations["place"][0]}, {}))
    assert (len(still), still.terminated) == (20, False)


def test_rounds_aggregate_and_the_student_improves() -> None:
    environment = DrawnPoint()
    first = [record(environment, expert, seed=seed, keys=("image",)) for seed in range(4)]
    settings = DaggerSettings(rounds=3, episodes=12, expert_share=0.5)
    student, rounds, everything = dagger(DrawnPoint, expert, first, settings, QUICK)
    assert [told.episodes for told in rounds] == [16, 28, 40]
    assert len(everything) == 40
    assert rounds[-1].disagreement < rounds[0].disagreement
    reached = [record(environment, student.controller(), seed=500 + k, keys=()).terminated for k in range(20)]
    assert np.mean(reached) >= 0.9


def test_same_seed_gives_the_same_student() -> None:
    first = [record(DrawnPoint(), expert, seed=seed, keys=("image",)) for seed in range(3)]
    settings, cloning = DaggerSettings(rounds=1, episodes=2), replace(QUICK, fit=replace(QUICK.fit, epochs=1))
    seen = {"image": first[0].observations["image"]}
    one, two = (dagger(DrawnPoint, expert, first, settings, cloning, seed=7)[0].act_batch(seen) for _ in range(2))
    np.testing.assert_array_equal(one, two)


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


def test_refuses_nothing_to_start_from() -> None:
    with pytest.raises(ValueError, match="no episodes to learn from"):
        dagger(DrawnPoint, expert, [], cloning=QUICK)
    with pytest.raises(ValueError, match="rounds must be greater than or equal to 1, got 0"):
        DaggerSettings(rounds=0)
