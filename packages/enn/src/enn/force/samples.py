"""Force samples: what is seen at the end of a step, beside the largest contact force of that step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from enn.trajectory import Trajectory, episode_numbers, require_same_shapes

SHAPE_COMPONENTS = 24  # principal components of the wire's shape that are matched beside the expert's features


@dataclass(frozen=True)
class ForceInputs:
    """What a force network sees of a step."""

    images: tuple[str, ...] = ("image",)  # names of image observations, of the end of the step
    vectors: tuple[str, ...] = ()  # names of further observations of that moment
    matched: bool = True  # whether the expert's features are predicted, too


FORCE_INPUTS = {
    "V": ForceInputs(),
    "V_plain": ForceInputs(matched=False),
    "V+M": ForceInputs(("image", "mask")),
    "I+V": ForceInputs(vectors=("joints",)),
    "I": ForceInputs((), ("joints",), matched=False),
}


class FeatureSource(Protocol):
    """An expert whose features are matched; `enn.policy.Policy` is one."""

    keys: tuple[str, ...]

    def features(self, observations: dict[str, NDArray[Any]], /) -> NDArray[np.float32]:
        """Features of observations with a leading N. Shape (N, features)."""


@dataclass(frozen=True)
class ForceSamples:
    """Samples to learn forces from.

    Raises:
        ValueError: lengths disagree, or a value is not finite.
    """

    images: NDArray[np.uint8]  # (N, channels, height, width) uint8; no channels where none are used
    vectors: NDArray[np.float32]  # (N, v) float32; v may be 0
    forces: NDArray[np.float32]  # (N,) float32, N, largest resultant contact force of the step
    episodes: NDArray[np.int64]  # (N,) number of the episode of each sample
    features: NDArray[np.float32] | None = None  # (N, z) float32, the expert's feature vector Z, or None

    def __post_init__(self) -> None:
        count = len(self.forces)
        for name in ("images", "vectors", "episodes", "features"):
            array = getattr(self, name)
            if array is None:
                continue
            if len(array) != count:
                raise ValueError(f"{count} forces need as many {name}, got {len(array)}")
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"{name} hold a value that is not finite: leave that episode out")
        if not np.isfinite(self.forces).all():
            raise ValueError("forces hold a value that is not finite: leave that episode out")

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.forces)

    def select(self, index: NDArray[np.int64]) -> ForceSamples:
        """Some of the samples."""
        return ForceSamples(
            self.images[index],
            self.vectors[index],
            self.forces[index],
            self.episodes[index],
            None if self.features is None else self.features[index],
        )

    def drawn(self, count: int, seed: int) -> ForceSamples:
        """So many samples, drawn without replacement; a larger draw with the same seed holds the smaller one.

        Raises:
            ValueError: there are not that many.
        """
        if count > len(self):
            raise ValueError(f"there are {len(self)} samples, {count} were asked for: record more episodes")
        return self.select(np.random.default_rng(seed).permutation(len(self))[:count])


def force_samples(
    trajectories: Sequence[Trajectory],
    inputs: ForceInputs = FORCE_INPUTS["V"],
    features: Sequence[NDArray[np.float32]] | None = None,
) -> ForceSamples:
    """Samples of episodes: a step each.

    Args:
        features: the expert's Z of each episode's moments, (T + 1, z), or None.

    Raises:
        ValueError: no episodes, episodes of different kinds, or features of another length.
    """
    images, vectors = inputs.images, inputs.vectors
    shapes = require_same_shapes(trajectories, (*images, *vectors))
    side = shapes[images[0]][1:] if images else (0, 0)
    seen, numbers, matched = [], [], []
    for index, trajectory in enumerate(trajectories):
        if images:
            seen.append(np.concatenate([trajectory.observations[key][1:] for key in images], axis=1))
        else:
            seen.append(np.zeros((len(trajectory), 0, *side), np.uint8))
        parts = [trajectory.observations[key][1:].reshape(len(trajectory), -1) for key in vectors]
        parts.append(np.zeros((len(trajectory), 0)))
        numbers.append(np.concatenate(parts, axis=1).astype(np.float32))
        if features is not None:
            if len(features) != len(trajectories) or len(features[index]) != len(trajectory) + 1:
                raise ValueError(
                    f"{trajectory.label} of {len(trajectory)} steps needs features of shape ({len(trajectory) + 1}, z)"
                )
            matched.append(features[index][1:].astype(np.float32))
    return ForceSamples(
        images=np.concatenate(seen),
        vectors=np.concatenate(numbers),
        forces=np.concatenate([trajectory.forces for trajectory in trajectories]).astype(np.float32),
        episodes=episode_numbers(trajectories),
        features=np.concatenate(matched) if features is not None else None,
    )


def matched_features(trajectories: Sequence[Trajectory], expert: FeatureSource) -> list[NDArray[np.float32]]:
    """What a force network predicts beside the force: the expert's features and the wire's shape.

    Args:
        trajectories: with the expert's observations, and `shape`.

    Returns:
        (T + 1, z) an episode.
    """
    shapes = principal_components([one.observations["shape"] for one in trajectories], SHAPE_COMPONENTS)
    return [
        np.concatenate((expert.features({key: one.observations[key] for key in expert.keys}), shape), axis=1)
        for one, shape in zip(trajectories, shapes, strict=True)
    ]


def split_episodes(episodes: Sequence[Trajectory], test_every: int) -> tuple[list[Trajectory], list[Trajectory]]:
    """Holds every so many-th episode out for the test, one at least.

    Args:
        episodes: at least one; a single one is learnt from and tested on.
        test_every: of so many episodes, the last is held out.

    Returns:
        Episodes to learn from, and episodes to test on.
    """
    if len(episodes) == 1:
        return list(episodes), list(episodes)
    held_out = [index % test_every == test_every - 1 for index in range(len(episodes))]
    held_out[-1] |= not any(held_out)
    return (
        [one for one, out in zip(episodes, held_out, strict=True) if not out],
        [one for one, out in zip(episodes, held_out, strict=True) if out],
    )


def training_and_test_samples(
    groups: Sequence[Sequence[Trajectory]], inputs: ForceInputs, expert: FeatureSource | None, test_every: int
) -> tuple[ForceSamples, ForceSamples]:
    """Splits the episodes of each group and turns them into samples.

    Args:
        groups: of at least one episode each, e.g. those of a target.
        expert: whose features are to be matched; None: none are.
        test_every: of so many episodes of a group, the last is held out.

    Returns:
        Samples to learn from, with the features to match, and samples to test on.
    """
    parts = [split_episodes(episodes, test_every) for episodes in groups]
    learnt = [one for training, _ in parts for one in training]
    tested = [one for _, test in parts for one in test]
    features = None if expert is None else matched_features(learnt, expert)
    return force_samples(learnt, inputs, features), force_samples(tested, inputs)


def principal_components(episodes: Sequence[NDArray[np.float32]], count: int) -> list[NDArray[np.float32]]:
    """A few numbers that say most of a larger observation, each with standard deviation 1 over all moments.

    Args:
        episodes: (T + 1, ...) each, such as the points of the wire.
        count: of components at most.

    Returns:
        (T + 1, components) an episode.

    Raises:
        ValueError: no episode.
    """
    if not episodes:
        raise ValueError("principal components need at least one episode")
    flat = np.concatenate([values.reshape(len(values), -1) for values in episodes]).astype(np.float64)
    centred = flat - flat.mean(axis=0)
    variances, directions = np.linalg.eigh(centred.T @ centred / len(centred))
    largest = [k for k in np.argsort(variances)[::-1][:count] if variances[k] > 1e-12 * variances.max()]
    components = (centred @ directions[:, largest] / np.sqrt(variances[largest])).astype(np.float32)
    return np.split(components, np.cumsum([len(values) for values in episodes])[:-1])
