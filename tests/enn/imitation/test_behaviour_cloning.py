"""Behaviour cloning and path following: students that learn, resuming, files, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from enn.fitting import EpisodeFitProgress, EpisodeFitSettings, FitError
from enn.imitation.behaviour_cloning import DESK_CLONING, clone
from enn.imitation.cloned_policy import ClonedPolicy, CloningNetworkSettings
from enn.imitation.dagger import record
from enn.imitation.path_following import PathFollower, PathFollowerSettings, PlannedPath, describe, fit_path_follower
from enn.trajectory import Trajectory
from tests.enn.imitation.drawn_point import SIDE, DrawnPoint, expert

QUICK = replace(
    DESK_CLONING, fit=EpisodeFitSettings(epochs=12, batch_size=32, learning_rate=3e-3, checkpoint_seconds=0)
)


@pytest.fixture(scope="module")
def episodes() -> list[Trajectory]:
    environment = DrawnPoint()
    return [record(environment, expert, seed=seed, keys=("image", "place")) for seed in range(60)]


@pytest.fixture(scope="module")
def student(episodes: list[Trajectory]) -> ClonedPolicy:
    return clone(episodes, QUICK)[0]


def test_student_reaches_the_target_from_the_image_alone(student: ClonedPolicy) -> None:
    environment = DrawnPoint()
    steers = student.controller()
    reached = [record(environment, steers, seed=1000 + seed, keys=()).terminated for seed in range(20)]
    assert np.mean(reached) >= 0.9


def test_interrupted_fit_goes_on_to_the_same_student(episodes: list[Trajectory], tmp_path: Path) -> None:
    settings = replace(QUICK, fit=replace(QUICK.fit, epochs=4), shift_px=2)
    straight, told = clone(episodes[:10], settings, seed=1)

    def stop(progress: EpisodeFitProgress) -> None:
        if progress.epoch == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        clone(episodes[:10], settings, seed=1, folder=tmp_path, progress=stop)
    resumed, retold = clone(episodes[:10], settings, seed=1, folder=tmp_path)
    assert [row["loss"] for row in told.rows] == [row["loss"] for row in retold.rows]
    for name, value in straight.network.state_dict().items():
        assert torch.equal(value, resumed.network.state_dict()[name]), name
    assert not list(tmp_path.iterdir())


def test_checkpoint_of_another_architecture_is_refused(episodes: list[Trajectory], tmp_path: Path) -> None:
    settings = replace(QUICK, fit=replace(QUICK.fit, epochs=3))

    def stop(progress: EpisodeFitProgress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        clone(episodes[:5], settings, folder=tmp_path, progress=stop)
    other = replace(settings, network=CloningNetworkSettings(features=64))
    with pytest.raises(FitError, match="is of another architecture: remove it to start again"):
        clone(episodes[:5], other, folder=tmp_path)
    for shown, changed in ((episodes[1:6], settings), (episodes[:5], replace(settings, shift_px=3))):
        with pytest.raises(FitError, match="a fit with other samples"):
            clone(shown, changed, folder=tmp_path)


def test_feature_matching_draws_the_students_features_to_the_experts(episodes: list[Trajectory]) -> None:
    settings = replace(QUICK, fit=replace(QUICK.fit, epochs=6, validation_share=0.0), feature_matching=1.0)
    features = [np.cos(0.2 * episode.observations["place"]).astype(np.float32) for episode in episodes]
    matched, _ = clone(episodes, settings, expert_features=features)
    seen = torch.as_tensor(np.concatenate([episode.observations["image"][:-1] for episode in episodes]))
    wanted = np.concatenate([values[:-1] for values in features])
    with torch.no_grad():
        got = matched.network.matching(matched.network.features(seen)).numpy()
    residual = got - (wanted - wanted.mean(0)) / wanted.std(0)
    assert np.square(residual).mean() < 0.3  # of a variance of one
    with pytest.raises(ValueError, match="features of each of 60 episodes, got 1"):
        clone(episodes, settings, expert_features=features[:1])
    spoilt = [np.full_like(values, np.nan) for values in features]
    with pytest.raises(ValueError, match="not finite"):
        clone(episodes, settings, expert_features=spoilt)


def test_student_refuses_what_it_was_not_trained_on(student: ClonedPolicy) -> None:
    for observation, said in (
        ({"image": np.zeros((1, 48, 48), np.uint8)}, r"images of shape \(1, 40, 40\), got \(1, 48, 48\)"),
        ({"mask": np.zeros((1, SIDE, SIDE), np.uint8)}, "image is missing"),
        ({"image": np.full((1, SIDE, SIDE), np.nan, np.float32)}, "not finite"),
    ):
        with pytest.raises(ValueError, match=said):
            student.act(observation)
    with pytest.raises(ValueError, match="needs a seeded numpy Generator"):
        student.act({"image": np.zeros((1, SIDE, SIDE), np.uint8)}, deterministic=False)


STEP = 0.002  # m a full action, in x and y
SETTINGS = PathFollowerSettings(fit=EpisodeFitSettings(epochs=40, batch_size=64, learning_rate=3e-3))


def bent_path(angle: float) -> np.ndarray:
    turn = np.array([np.cos(angle), np.sin(angle), 0.0])
    return np.array([[0, 0, 0], [0.03, 0, 0], np.array([0.03, 0, 0]) + 0.03 * turn])


def walk(path: PlannedPath, start: np.ndarray, act: object = None, steps: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Goes along a path, by default as an expert does: towards a point 6 mm ahead."""
    tips, actions, along = [start], [], 0.0
    for _ in range(steps):
        along = path.progress(tips[-1], along)
        if act is None:
            away = path.at(np.array([along + 0.006]))[0] - tips[-1]
            action = np.clip(away[:2] / 0.006, -1, 1)
        else:
            action = act(None, {"tip": tips[-1]})  # type: ignore[operator]
        actions.append(action)
        tips.append(tips[-1] + STEP * np.append(action, 0.0))
    return np.array(tips), np.array(actions, np.float32)


def episode(angle: float, seed: int) -> Trajectory:
    start = np.append(np.random.default_rng(seed).normal(0, 0.002, 2), 0.0)
    tips, actions = walk(PlannedPath(bent_path(angle)), start)
    count = len(actions)
    return Trajectory({}, actions, np.zeros(count), True, np.zeros(count), tips)


@pytest.fixture(scope="module")
def follower() -> PathFollower:
    angles = np.linspace(-1.2, 1.2, 12)
    return fit_path_follower([episode(a, k) for k, a in enumerate(angles)], [bent_path(a) for a in angles], SETTINGS)[0]


def test_what_is_seen_is_relative_to_the_tip() -> None:
    path, moved = PlannedPath(bent_path(0.5)), PlannedPath(bent_path(0.5) + 0.1)
    tips = [np.array([0.0, 0.001, 0.0]), np.array([0.002, 0.001, 0.0])]
    seen = describe(tips, path, 0.002, SETTINGS)
    assert seen.shape == (SETTINGS.size,)
    np.testing.assert_allclose(seen, describe([tip + 0.1 for tip in tips], moved, 0.002, SETTINGS), atol=1e-4)
    np.testing.assert_allclose(seen[:3], [-0.1, 0, 0], atol=1e-6)  # where it was before: 2 mm, 50 a metre


def test_follows_a_path_it_has_not_seen(follower: PathFollower) -> None:
    target = bent_path(0.7)
    controller = follower.controller(target)
    controller.reset()
    tips, _ = walk(PlannedPath(target), np.array([0.0, 0.001, 0.0]), controller)
    assert np.linalg.norm(tips - target[-1], axis=1).min() < 0.006
