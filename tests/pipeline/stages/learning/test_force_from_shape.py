"""Forces from the logged shape are of the frames that the networks are tested on, and close to the true ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from pipeline.jobs.worker import Report
from pipeline.recording.record import record_episode
from pipeline.stages.learning.force import TEST_EVERY, ShapeForceJob, forces_from_shape, test_frames
from pipeline.stages.learning.task import LearningTask
from pipeline.task import Task

STEPS = 110


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> ShapeForceJob:
    folder = tmp_path_factory.mktemp("shape")
    task = LearningTask("type_1", "bca", Task(max_steps=STEPS, image_size_px=36))
    environment = task.environment(("feeder", "tip", "image"))
    forward = np.array([1.0, 0.3], np.float32)
    for number in range(2):
        path = folder / "episodes" / f"{number:03d}.mcap"
        record_episode(environment, lambda *_: forward, path, seed=number, operator="script")
    return ShapeForceJob(folder / "shape", "type_1", (folder / "episodes",), 1000, 0, disturbed=False)


def test_forces_of_the_held_out_episode_are_estimated(job: ShapeForceJob) -> None:
    from enn.force.samples import force_samples, split_episodes
    from pipeline.stages.learning.expert_episodes import read_episodes

    estimated, true, refused = test_frames(job, Report())
    held_out = split_episodes(read_episodes(sorted(job.logs[0].glob("*.mcap"))), TEST_EVERY)[1]
    expected = force_samples(held_out).drawn(len(true), job.seed)
    np.testing.assert_array_equal(true, expected.forces)
    assert refused == 0
    assert true.max() > 0.1
    assert np.corrcoef(estimated, true)[0, 1] > 0.9


def test_forces_of_a_wire_in_a_catheter_are_estimated(tmp_path: Path) -> None:
    task = LearningTask("type_1", "bca", Task(max_steps=STEPS, image_size_px=36, catheter="vertebral_5f"))
    environment = task.environment(("feeder", "tip", "image"))
    forward = np.array([1.0, 0.1, 1.0, 0.1], np.float32)
    for number in range(2):
        path = tmp_path / "episodes" / f"{number:03d}.mcap"
        record_episode(environment, lambda *_: forward, path, seed=number, operator="script")
    job = ShapeForceJob(tmp_path / "shape", "type_1", (tmp_path / "episodes",), 1000, 0, disturbed=False)
    estimated, true, refused = test_frames(job, Report())
    assert refused == 0
    assert true.max() > 0.01
    assert np.corrcoef(estimated, true)[0, 1] > 0.7
    assert np.isfinite(test_frames(dataclasses.replace(job, disturbed=True), Report())[0]).all()


def test_an_outcome_is_kept_and_errors_make_it_worse(job: ShapeForceJob, monkeypatch: pytest.MonkeyPatch) -> None:
    exact = forces_from_shape(job, Report())
    disturbed = forces_from_shape(
        dataclasses.replace(job, folder=job.folder.with_name("errors"), disturbed=True), Report()
    )
    assert exact["share_pct"] == pytest.approx(100 * exact["mse_n2"] / exact["variance_n2"])
    assert exact["share_pct"] < min(20.0, disturbed["share_pct"])
    monkeypatch.setattr("enn.force.samples.split_episodes", None)
    assert forces_from_shape(job, Report()) == exact
    assert Path(job.folder / "force.json").is_file()
