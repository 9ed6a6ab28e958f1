"""Path following: progress along a path, a follower that learns a simple one, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from enn.fitting import EpisodeFitSettings
from enn.imitation.path_following import (
    PathFollower,
    PathFollowerSettings,
    PlannedPath,
    describe,
    fit_path_follower,
)
from enn.model_file import decoded, write_model
from enn.trajectory import Trajectory

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


def test_saved_follower_acts_the_same(follower: PathFollower, tmp_path: Path) -> None:
    follower.save(tmp_path / "f.pt")
    seen = np.random.default_rng(0).normal(size=(4, SETTINGS.size)).astype(np.float32)
    np.testing.assert_array_equal(PathFollower.load(tmp_path / "f.pt").act(seen), follower.act(seen))
    content = decoded((tmp_path / "f.pt").read_bytes())
    content["settings"]["history"] = 9
    write_model(tmp_path / "other.pt", content)
    with pytest.raises(ValueError, match="another architecture"):
        PathFollower.load(tmp_path / "other.pt")
    (tmp_path / "bad.pt").write_bytes(b"x")
    with pytest.raises(ValueError, match="damaged or no path follower"):
        PathFollower.load(tmp_path / "bad.pt")
