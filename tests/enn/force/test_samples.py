"""Force samples: what is seen of a step, draws, held-out episodes, features to match."""

from __future__ import annotations

import numpy as np
import pytest

from enn.force.samples import (
    ForceInputs,
    ForceSamples,
    force_samples,
    matched_features,
    principal_components,
    split_episodes,
)
from enn.trajectory import Trajectory


def test_a_sample_is_the_end_of_a_step_and_its_force(episodes: list[Trajectory]) -> None:
    samples = force_samples(episodes[:2], ForceInputs(vectors=("place",), frames=3, actions=True))
    first = episodes[0]
    images = first.observations["image"]
    np.testing.assert_array_equal(samples.images[0], np.concatenate((images[0], images[0], images[1])))
    np.testing.assert_array_equal(samples.images[2], np.concatenate((images[1], images[2], images[3])))
    np.testing.assert_allclose(samples.vectors[0], np.append(first.observations["place"][1], first.actions[0]))
    np.testing.assert_allclose(samples.forces[: len(first)], first.forces, rtol=1e-6)
    assert (samples.episodes == np.repeat([0, 1], [len(e) for e in episodes[:2]])).all()


def test_draws_are_nested_and_bounded(halves: tuple[ForceSamples, ForceSamples]) -> None:
    samples = halves[0]
    few, more = samples.drawn(10, seed=1), samples.drawn(20, seed=1)
    np.testing.assert_array_equal(few.forces, more.forces[:10])
    with pytest.raises(ValueError, match="record more episodes"):
        samples.drawn(len(samples) + 1, seed=1)


def test_principal_components_are_uncorrelated_and_of_unit_size() -> None:
    generator = np.random.default_rng(0)
    hidden = generator.normal(size=(300, 2))
    points = (hidden @ generator.normal(size=(2, 12))).reshape(300, 4, 3).astype(np.float32)
    parts = principal_components([points[:100], points[100:]], 6)
    assert [part.shape for part in parts] == [(100, 2), (200, 2)]
    np.testing.assert_allclose(np.cov(np.concatenate(parts).T, bias=True), np.eye(2), atol=1e-3)


def test_every_so_many_th_episode_is_held_out(episodes: list[Trajectory]) -> None:
    learnt, tested = split_episodes(episodes[:9], 4)
    assert [id(one) for one in tested] == [id(episodes[3]), id(episodes[7])]
    assert len(learnt) == 7
    assert [len(part) for part in split_episodes(episodes[:3], 4)] == [2, 1]
    assert [len(part) for part in split_episodes(episodes[:1], 4)] == [1, 1]


def test_matched_features_are_the_experts_and_the_shape(episodes: list[Trajectory]) -> None:
    class Expert:
        keys = ("place",)

        def features(self, observations: dict[str, np.ndarray]) -> np.ndarray:
            return 2 * observations["place"]

    for episode in episodes[:3]:
        episode.observations["shape"] = np.random.default_rng(len(episode)).normal(size=(len(episode) + 1, 5, 3))
    features = matched_features(episodes[:3], Expert())
    np.testing.assert_array_equal(features[1][:, :2], 2 * episodes[1].observations["place"])
    assert [part.shape for part in features] == [(len(one) + 1, 2 + 15) for one in episodes[:3]]
