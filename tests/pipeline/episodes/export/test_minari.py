"""Minari reads what was exported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.export.exporting import export_logs

minari = pytest.importorskip("minari")


@pytest.mark.parametrize("kind", ["wire_logs", "dual_logs"])
def test_minari_reads_the_data_set(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = request.getfixturevalue(kind)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "elsewhere"))
    export_logs(folder, "minari", tmp_path / "out", name="arteries")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "out"))
    data = minari.load_dataset("arteries-v0")
    assert not list((tmp_path / "elsewhere").glob("*"))
    assert (data.total_episodes, data.total_steps) == (2, 15)
    layout = json.loads(data.storage.metadata["endonav_layout"])
    assert layout["observations"]["feeder"]["frame"] == "device"
    for index, episode in enumerate(data.iterate_episodes()):
        with EpisodeReader(folder / f"{index}.mcap") as log:
            arrays, info = log.load_arrays(), log.info
        assert np.array_equal(episode.actions, arrays["action"][1:])
        assert np.array_equal(episode.rewards, arrays["reward"][1:])
        assert np.array_equal(episode.observations["joint_positions"], arrays["joint_positions"])
        assert np.array_equal(episode.observations["frontal"][..., 0], arrays["image/frontal"])
        assert np.array_equal(episode.infos["distance_m"], arrays["extra/distance_m"])
        assert episode.truncations.tolist() == [False] * (6 + index) + [True]
        assert not episode.terminations.any()
        assert episode.infos["success"].shape == (8 + index,)
        first = {name: values[0] for name, values in episode.observations.items()}
        assert data.observation_space.contains(first)
        assert data.action_space.contains(episode.actions[0])
        known = next(iter(data.storage.get_episode_metadata([index])))
        assert known["task"] == f"reach the {info.target} in type_1"
        assert known["seed"] == index
    assert len(data.filter_episodes(lambda episode: len(episode.rewards) == 8)) == 1
