"""LeRobotDataset v3: the files as they are described, and as LeRobot itself reads them."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.export.exporting import export_logs

pq = pytest.importorskip("pyarrow.parquet")

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
LEROBOT = Path(os.environ.get("LEROBOT_PYTHON") or CACHE / "endonav" / "lerobot" / "bin" / "python")
READING = Path(__file__).with_name("lerobot_reading.py")


def expected_columns(folder: Path) -> dict[str, np.ndarray]:
    """What the rows of a data set should hold, from the logs themselves."""
    rows: dict[str, list[np.ndarray]] = {}
    for index, path in enumerate(sorted(folder.glob("*.mcap"))):
        with EpisodeReader(path) as log:
            arrays, info, mesh = log.load_arrays(), log.info, log.phantom_mesh()
        assert mesh is not None
        steps = len(arrays["step"]) - 1
        ended = np.arange(steps) == steps - 1
        columns = {
            "observation.state": np.load(path.with_suffix(".npy")),
            "observation.environment_state": np.tile(mesh.target, (steps, 1)),
            "observation.images.frontal": arrays["image/frontal"][:-1],
            "action": arrays["action"][1:],
            "next.reward": arrays["reward"][1:],
            "next.done": ended,
            "next.truncated": ended,
            "next.success": np.zeros(steps, bool),
            "info.force": arrays["resultant_force"][:-1],
            "info.distance_m": arrays["extra/distance_m"][:-1],
            "info.joint_positions": arrays["joint_positions"][:-1],
            "timestamp": arrays["time_s"][:-1],
            "episode_index": np.full(steps, index),
            "frame_index": np.arange(steps),
            "task": np.full(steps, f"reach the {info.target} in type_1"),
        }
        if info.has_catheter:
            columns["info.device_feeder_forces"] = arrays["devices/feeder_forces"][:-1]
        for name, values in columns.items():
            rows.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in rows.items()}


@pytest.mark.parametrize("kind", ["wire_logs", "dual_logs"])
def test_the_files_hold_what_they_say(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    folder = request.getfixturevalue(kind)
    export_logs(folder, "lerobot", tmp_path / "out")
    expected = expected_columns(folder)
    info = json.loads((tmp_path / "out" / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, 15, 10)
    table = pq.read_table(tmp_path / "out" / info["data_path"].format(chunk_index=0, file_index=0))
    stored = {name for name, feature in info["features"].items() if feature["dtype"] != "video"}
    assert set(table.column_names) == stored
    for name in set(expected) & stored:
        found = np.array(table[name].to_pylist())
        np.testing.assert_allclose(found, expected[name], rtol=1e-6, atol=1e-9, err_msg=name)
        feature = info["features"][name]
        assert feature["shape"] == [*(found.shape[1:] or (1,))]
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    episodes = pq.read_table(tmp_path / "out" / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [one["dataset_from_index"] for one in episodes] == [0, 7]
    assert episodes[1]["videos/observation.images.frontal/from_timestamp"] == pytest.approx(0.7)
    known = json.loads((tmp_path / "out" / "meta" / "endonav.json").read_text())
    assert known["layout"]["observations"]["tip"]["unit"] == "m"
    assert known["episodes"][1]["target"] == "lcca"
    assert "P" in known["episodes"][0]["cameras"]["frontal"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wire_logs", "dual_logs"])
def test_lerobot_reads_the_data_set(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    if not LEROBOT.is_file():
        pytest.skip(f"no environment with LeRobot at {LEROBOT}: `make lerobot` makes one (8 GB), or set LEROBOT_PYTHON")
    folder = request.getfixturevalue(kind)
    export_logs(folder, "lerobot", tmp_path / "out")
    np.savez(tmp_path / "expected.npz", **expected_columns(folder))
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hub")}
    command = [str(LEROBOT), str(READING), str(tmp_path / "out"), str(tmp_path / "expected.npz")]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr[-3000:]
    read = json.loads(done.stdout.splitlines()[-1])
    assert (read["steps"], read["fps"]) == (15, 10)
    assert read["worst_grey"] <= 8
