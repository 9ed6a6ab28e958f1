"""Expert episodes: what a log gives, damaged logs, episodes of several kinds, and forces from logged shapes."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from enn.force.samples import force_samples, split_episodes
from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import Report
from pipeline.recording.record import record_episode
from pipeline.stages.learning.expert_episodes import (
    expert_folder,
    expert_logs,
    load_expert,
    read_episode,
    read_episodes,
    task_of_log,
    task_of_logs,
)
from pipeline.stages.learning.force import TEST_EVERY, ShapeForceJob, estimated_and_true, forces_from_shape
from pipeline.stages.learning.task import LearningTask
from pipeline.store.errors import StageError
from pipeline.task import Task
from tests.pipeline.stages.small_expert import TASK, write_expert


@pytest.fixture(scope="module")
def enn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "enn"
    write_expert(folder)
    return folder


def test_an_episode_reads_as_the_environment_showed_it(enn: Path) -> None:
    log = expert_logs(expert_folder(enn, "type_1/bca", "I+V+M"))[1]
    episode = read_episode(log)
    environment = TASK.environment(("image", "mask", "joints", "feeder", "shape"))
    assert task_of_log(log) == TASK
    with EpisodeReader(log) as reader:
        seen, _ = environment.reset(seed=reader.info.seed)
    for step in range(len(episode) + 1):
        for name, value in seen.items():
            np.testing.assert_array_equal(episode.observations[name][step], value, err_msg=f"{name}, step {step}")
        if step < len(episode):
            seen, _, _, _, info = environment.step(episode.actions[step])
            assert episode.forces[step] == pytest.approx(info["force"], abs=1e-12)


def test_a_damaged_log_is_left_out_by_name_and_a_damaged_expert_refused(
    enn: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shutil.copytree(enn, tmp_path / "enn")
    logs = expert_logs(expert_folder(tmp_path / "enn", "type_1/bca", "I+V+M"))
    data = logs[1].read_bytes()
    logs[1].write_bytes(data[: len(data) // 2])
    episodes = read_episodes(logs)
    assert [Path(episode.label).name for episode in episodes] == ["000.mcap", "002.mcap", "003.mcap"]
    assert len(caplog.messages) == 1
    assert "001.mcap is left out" in caplog.messages[0]
    assert task_of_logs(logs[1:]) == TASK
    with pytest.raises(StageError, match="no episode that can be read"):
        task_of_logs(logs[1:2])
    (tmp_path / "policy.pt").write_bytes(b"no policy")
    with pytest.raises(StageError, match="damaged or no policy"):
        load_expert(tmp_path)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [({"image_size_px": 48}, "another image size"), ({"wire": "thesis"}, "another wire or catheter")],
)
def test_episodes_of_another_kind_are_one_sentence(enn: Path, tmp_path: Path, changed: dict, sentence: str) -> None:
    task = replace(TASK, task=replace(TASK.task, max_steps=1, **changed))
    other = write_expert(tmp_path / "other", episodes=1, task=task)
    logs = [*expert_logs(expert_folder(enn, "type_1/bca", "I+V+M"))[:1], *expert_logs(other)]
    with pytest.raises(StageError, match=sentence):
        read_episodes(logs)


STEPS = 110


def recorded(folder: Path, action: list[float], **task: str) -> ShapeForceJob:
    """A job with two episodes of one action."""
    asked = LearningTask("type_1", "bca", Task(max_steps=STEPS, image_size_px=36, **task))
    environment = asked.environment(("feeder", "tip", "image"))
    for number in range(2):
        path = folder / "episodes" / f"{number:03d}.mcap"
        record_episode(environment, lambda *_: np.array(action, np.float32), path, seed=number, operator="script")
    return ShapeForceJob("type_1", (folder / "episodes",), 1000, 0, disturbed=False)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> ShapeForceJob:
    return recorded(tmp_path_factory.mktemp("shape"), [1.0, 0.3])


def test_forces_of_the_held_out_episode_are_estimated(job: ShapeForceJob) -> None:
    estimated, true, refused = estimated_and_true(job, Report())
    held_out = split_episodes(read_episodes(sorted(job.logs[0].glob("*.mcap"))), TEST_EVERY)[1]
    expected = force_samples(held_out).drawn(len(true), job.seed)
    np.testing.assert_array_equal(true, expected.forces)
    assert refused == 0
    assert true.max() > 0.1
    assert np.corrcoef(estimated, true)[0, 1] > 0.9


def test_forces_of_a_wire_in_a_catheter_are_estimated(tmp_path: Path) -> None:
    job = recorded(tmp_path, [1.0, 0.1, 1.0, 0.1], catheter="vertebral_5f")
    estimated, true, refused = estimated_and_true(job, Report())
    assert refused == 0
    assert true.max() > 0.01
    assert np.corrcoef(estimated, true)[0, 1] > 0.7
    assert np.isfinite(estimated_and_true(replace(job, disturbed=True), Report())[0]).all()


def test_errors_make_an_estimate_worse(job: ShapeForceJob) -> None:
    exact = forces_from_shape(job, Report())
    disturbed = forces_from_shape(replace(job, disturbed=True), Report())
    assert exact["share_pct"] == pytest.approx(100 * exact["mse_n2"] / exact["variance_n2"])
    assert exact["share_pct"] < min(20.0, disturbed["share_pct"])
