"""HDF5: everything that the logs hold is read back, with units and frames."""

from __future__ import annotations

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
