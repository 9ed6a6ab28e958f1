"""Exports to HDF5 and Minari: what their own readers find."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.export.exporting import export_logs

h5py = pytest.importorskip("h5py")


@pytest.mark.parametrize("kind", ["wire_logs", "dual_logs"])
def test_everything_is_read_back(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    folder = request.getfixturevalue(kind)
    export_logs(folder, "hdf5", tmp_path / "out", masks=True)
    with h5py.File(tmp_path / "out" / "episodes.hdf5") as file:
        assert (file.attrs["episodes"], file.attrs["steps"]) == (2, 15)
        assert json.loads(file.attrs["metadata"])["observations"]["tip"]["frame"] == "world"
        for index in range(2):
            with EpisodeReader(folder / f"{index}.mcap") as log:
                arrays, info, mesh = log.load_arrays(), log.info, log.phantom_mesh()
            demo = file[f"data/demo_{index}"]
            assert demo.attrs["task"] == f"reach the {info.target} in type_1"
            assert demo.attrs["num_samples"] == 7 + index
            assert json.loads(demo.attrs["metadata"])["seed"] == index
            for name, key in (("actions", "action"), ("rewards", "reward"), ("terminated", "terminated")):
                assert np.array_equal(demo[name][:], arrays[key][1:])
            assert demo["dones"][:].tolist() == [False] * (6 + index) + [True]
            for name in ("tip", "joint_positions", "joint_velocities"):
                assert np.array_equal(demo[f"obs/{name}"][:], arrays[name])
            assert np.array_equal(demo["obs/force"][:], arrays["resultant_force"])
            assert mesh is not None
            assert np.array_equal(demo["obs/goal"][3], mesh.target)
            assert np.array_equal(demo["obs/image/frontal"][:], arrays["image/frontal"])
            assert np.array_equal(demo["obs/mask/frontal"][:] > 0, arrays["mask/frontal"])
            assert np.array_equal(demo["infos/distance_m"][:], arrays["extra/distance_m"])
            assert np.array_equal(demo["log/wire_points"][:], arrays["wire_points"], equal_nan=True)
            assert demo["obs/feeder"].attrs["frame"] == "device"
            seen = np.load(folder / f"{index}.npy")
            state = np.concatenate((demo["obs/tip"][:-1], demo["obs/feeder"][:-1]), axis=1)
            assert np.array_equal(state.astype(np.float32), seen), "as the environment's observation was"
            if kind == "dual_logs":
                assert np.array_equal(demo["infos/device_hub_torques"][:], arrays["devices/hub_torques"])


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
