"""Expert episodes: what a log gives, damaged logs, episodes of several kinds."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader
from pipeline.stages.learning.expert_episodes import (
    expert_folder,
    expert_logs,
    load_expert,
    read_episode,
    read_episodes,
    task_of_log,
    task_of_logs,
)
from pipeline.store.errors import StageError
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


def test_a_damaged_log_is_left_out_by_name(enn: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    shutil.copytree(enn, tmp_path / "enn")
    logs = expert_logs(expert_folder(tmp_path / "enn", "type_1/bca", "I+V+M"))
    data = logs[1].read_bytes()
    logs[1].write_bytes(data[: len(data) // 2])
    episodes = read_episodes(logs)
    assert [Path(episode.label).name for episode in episodes] == ["000.mcap", "002.mcap", "003.mcap"]
    assert len(caplog.messages) == 1
    assert "001.mcap is left out" in caplog.messages[0]
    assert task_of_logs(logs[1:]) == TASK
    with pytest.raises(StageError, match=r"no episode that can be read of 1 in .*: run stage=enn again"):
        task_of_logs(logs[1:2])


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"image_size_px": 48}, "another image size: its 'image' has shape"),
        ({"wire": "thesis"}, "another wire or catheter than"),
    ],
)
def test_episodes_of_another_kind_are_one_sentence(enn: Path, tmp_path: Path, changed: dict, sentence: str) -> None:
    other = write_expert(
        tmp_path / "other", episodes=1, task=replace(TASK, task=replace(TASK.task, max_steps=1, **changed))
    )
    logs = [*expert_logs(expert_folder(enn, "type_1/bca", "I+V+M"))[:1], *expert_logs(other)]
    with pytest.raises(StageError, match=sentence):
        read_episodes(logs)


def test_a_damaged_expert_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "policy.pt").write_bytes(b"no policy")
    with pytest.raises(StageError, match="damaged or no policy"):
        load_expert(tmp_path)
