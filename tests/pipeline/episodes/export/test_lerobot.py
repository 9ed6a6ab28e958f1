"""Exports to LeRobot: what its own reader finds, its statistics and videos."""

import json
import os
import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.export.exporting import export_logs
from pipeline.episodes.export.statistics import of_greys, of_rows, together, write_grey_video

pa = pytest.importorskip("pyarrow")
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
    files = [tmp_path / "out" / info["data_path"].format(chunk_index=0, file_index=index) for index in range(2)]
    table = pa.concat_tables(map(pq.read_table, files))
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
    assert episodes[1]["data/file_index"] == episodes[1]["videos/observation.images.frontal/file_index"] == 1
    assert episodes[1]["videos/observation.images.frontal/to_timestamp"] == pytest.approx(0.8)
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


@pytest.mark.parametrize(("size", "stored"), [((48, 64), "yuv420p"), ((47, 65), "yuv444p")])
def test_pictures_come_back(size: tuple[int, int], stored: str, tmp_path: Path) -> None:
    rows, columns = np.indices(size)
    pictures = [((rows * 3 + columns * 2 + 40 * index) % 200 + 30).astype(np.uint8) for index in range(9)]
    write_grey_video(tmp_path / "a.mp4", pictures, 7.5)
    frames = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"), pix_fmt="gray", bits_per_pixel=8)
    meta = next(frames)
    assert meta["fps"] == 7.5
    assert meta["pix_fmt"].startswith(stored)
    found = [np.frombuffer(frame, np.uint8).reshape(size) for frame in frames]
    assert len(found) == len(pictures)
    for one, picture in zip(found, pictures, strict=True):
        assert np.abs(one.astype(int) - picture).mean() < 3


def test_rows_against_numpy() -> None:
    values = np.random.default_rng(0).normal(size=(50, 3))
    found = of_rows(values)
    np.testing.assert_allclose(found["mean"], values.mean(axis=0))
    np.testing.assert_allclose(found["q90"], np.quantile(values, 0.9, axis=0))
    assert found["count"].tolist() == [50]
    assert of_rows(values[:, 0])["min"].shape == (1,)


def test_a_part_without_numbers_gives_zeros() -> None:
    values = np.stack([np.full(4, np.nan), [1.0, np.nan, 3.0, 2.0]], axis=1)
    found = of_rows(values)
    assert found["mean"].tolist() == [0.0, 2.0]
    assert found["max"].tolist() == [0.0, 3.0]


def test_pictures_against_numpy() -> None:
    pictures = np.random.default_rng(1).integers(0, 256, (5, 20, 30), np.uint8)
    found, shares = of_greys(list(pictures)), pictures / 255.0
    assert found["mean"].shape == (3, 1, 1)
    np.testing.assert_allclose(found["mean"][0], shares.mean())
    np.testing.assert_allclose(found["std"][0], shares.std())
    np.testing.assert_allclose(found["q50"][0], np.quantile(shares, 0.5), atol=1 / 255)
    assert found["count"].tolist() == [5]


def test_together_is_the_statistics_of_all() -> None:
    values = np.random.default_rng(2).normal(size=(60, 2))
    found, whole = together([of_rows(values[:10]), of_rows(values[10:])]), of_rows(values)
    for name in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(found[name], whole[name])
