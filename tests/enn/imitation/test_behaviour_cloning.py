"""Behaviour cloning: the thesis's network and loss, a student that learns, resuming, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from enn.fitting import EpisodeFitProgress, EpisodeFitSettings, FitError
from enn.imitation.behaviour_cloning import (
    DESK_CLONING,
    clone,
)
from enn.imitation.cloned_policy import ClonedPolicy, CloningNetworkSettings
from enn.imitation.dagger import record
from enn.model_file import decoded, write_model
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
    settings = replace(QUICK, fit=replace(QUICK.fit, epochs=4), noise=2.0)
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
    for shown, changed in ((episodes[1:6], settings), (episodes[:5], replace(settings, noise=3.0))):
        with pytest.raises(FitError, match="a fit with other samples"):
            clone(shown, changed, folder=tmp_path)
    (tmp_path / "fit.pt").write_bytes(b"nothing")
    with pytest.raises(FitError, match="damaged"):
        clone(episodes[:5], settings, folder=tmp_path)


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


def test_saved_student_acts_the_same(student: ClonedPolicy, episodes: list[Trajectory], tmp_path: Path) -> None:
    student.save(tmp_path / "student.pt")
    seen = {"image": episodes[0].observations["image"]}
    loaded = ClonedPolicy.load(tmp_path / "student.pt")
    np.testing.assert_array_equal(loaded.act_batch(seen), student.act_batch(seen))
    content = decoded((tmp_path / "student.pt").read_bytes())
    content["settings"]["features"] = 64
    write_model(tmp_path / "other.pt", content)
    with pytest.raises(ValueError, match="another architecture"):
        ClonedPolicy.load(tmp_path / "other.pt")
    with pytest.raises(FileNotFoundError, match="no cloned policy"):
        ClonedPolicy.load(tmp_path / "none.pt")


def test_student_refuses_what_it_was_not_trained_on(student: ClonedPolicy) -> None:
    with pytest.raises(ValueError, match=r"trained with images of shape \(1, 40, 40\), got \(1, 48, 48\)"):
        student.act({"image": np.zeros((1, 48, 48), np.uint8)})
    with pytest.raises(ValueError, match="image is missing"):
        student.act({"mask": np.zeros((1, SIDE, SIDE), np.uint8)})
    with pytest.raises(ValueError, match="not finite"):
        student.act({"image": np.full((1, SIDE, SIDE), np.nan, np.float32)})
    with pytest.raises(ValueError, match="needs a seeded numpy Generator"):
        student.act({"image": np.zeros((1, SIDE, SIDE), np.uint8)}, deterministic=False)
