"""LeRobotDataset v3.0: parquet for numbers, mp4 for pictures, and metadata; written without LeRobot.

    meta/info.json                              features, paths, frames a second
    meta/stats.json                             statistics of every feature
    meta/tasks.parquet                          the tasks in words
    meta/episodes/chunk-000/file-000.parquet    where each episode lies, and its statistics
    meta/endonav.json                           units and frames of every field; of each episode what its log knows
    data/chunk-000/file-000.parquet             one row a step, one file an episode
    videos/observation.images.<camera>/chunk-000/file-000.mp4

A row holds the observation before its action, the action, and what followed: next.reward, next.done, next.truncated,
next.success. The observation after the last action has no row. `observation.state` is the tip and the feeder,
`observation.environment_state` the goal.

Source: LeRobot 0.4.4, `lerobot/datasets/lerobot_dataset.py`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.episodes.export import statistics
from pipeline.episodes.export.layout import ExportEpisode, ExportError, Layout
from pipeline.episodes.export.statistics import CODEC, Statistics, pixel_format
from pipeline.episodes.records import as_json

VERSION = "v3.0"
STATE = ("tip", "feeder")  # as the environment's observation ("tip", "feeder") gives them
FILES_IN_CHUNK = 1000
DATA_MB, VIDEO_MB = 100, 200  # of a file, as LeRobot has them where it adds episodes
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_EPISODES = "meta/episodes/chunk-000/file-000.parquet"
_COUNTERS = dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")


class LeRobotWriter:
    """Writes episodes as a LeRobotDataset into a folder, one after the other."""

    def __init__(self, folder: Path, layout: Layout, name: str) -> None:
        """Prepare the writer; an ExportError where pyarrow is not installed."""
        try:
            import pyarrow  # noqa: F401
        except ImportError as error:
            raise ExportError("LeRobot's format needs pyarrow: pip install 'endonav[export]'") from error
        self._folder, self._layout, self._name = folder, layout, name
        self.features = _features(layout)
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []
        self._statistics: list[dict[str, Statistics]] = []
        self._described: list[dict[str, Any]] = []
        self._frames = 0

    def add(self, episode: ExportEpisode) -> None:
        index, steps = len(self._rows), episode.steps
        task = self._tasks.setdefault(episode.task, len(self._tasks))
        columns = _columns(episode)
        columns |= {
            "timestamp": (np.arange(steps) / self._layout.fps).astype(np.float32),
            "frame_index": np.arange(steps),
            "episode_index": np.full(steps, index),
            "index": np.arange(self._frames, self._frames + steps),
            "task_index": np.full(steps, task),
        }
        summaries = {name: statistics.of_rows(values) for name, values in columns.items()}
        row: dict[str, Any] = {
            "episode_index": index,
            "tasks": [episode.task],
            "length": steps,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + steps,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        row |= self._write_rows(columns)
        for camera in self._layout.pictures:
            place, summaries[_video_key(camera)] = self._write_pictures(camera, episode)
            row |= place
        for name, values in summaries.items():
            row |= {f"stats/{name}/{one}": value.tolist() for one, value in values.items()}
        self._rows.append(row)
        self._statistics.append(summaries)
        self._described.append(episode.describe())
        self._frames += steps

    def _place(self, what: str, pattern: str, **names: str) -> tuple[Path, dict[str, Any]]:
        """The file of the present episode, and how its row names it."""
        chunk, file = divmod(len(self._rows), FILES_IN_CHUNK)
        path = self._folder / pattern.format(chunk_index=chunk, file_index=file, **names)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path, {f"{what}/chunk_index": chunk, f"{what}/file_index": file}

    def _write_rows(self, columns: dict[str, np.ndarray]) -> dict[str, Any]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        path, place = self._place("data", _DATA)
        arrays = {name: _column(columns[name], self.features[name]["dtype"]) for name in _stored(self.features)}
        pq.write_table(pa.table(arrays), path, compression="snappy")
        return place

    def _write_pictures(self, camera: str, episode: ExportEpisode) -> tuple[dict[str, Any], Statistics]:
        key = _video_key(camera)
        path, place = self._place(f"videos/{key}", _VIDEO, video_key=key)
        pictures = [picture for picture, _ in zip(episode.pictures(camera), range(episode.steps), strict=False)]
        statistics.write_grey_video(path, pictures, self._layout.fps)
        place[f"videos/{key}/from_timestamp"] = 0.0
        place[f"videos/{key}/to_timestamp"] = episode.steps / self._layout.fps
        return place, statistics.of_greys(pictures)

    def finish(self) -> None:
        """Write the metadata."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        meta = self._folder / "meta"
        (self._folder / _EPISODES).parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist(self._rows), self._folder / _EPISODES)
        pq.write_table(_task_table(self._tasks), meta / "tasks.parquet")
        whole = {name: statistics.together([one[name] for one in self._statistics]) for name in self._statistics[0]}
        plain = {name: {one: value.tolist() for one, value in summary.items()} for name, summary in whole.items()}
        _write_json(meta / "stats.json", plain)
        episodes = len(self._rows)
        _write_json(
            meta / "info.json",
            {
                "codebase_version": VERSION,
                "robot_type": "cathsim",
                "total_episodes": episodes,
                "total_frames": self._frames,
                "total_tasks": len(self._tasks),
                "chunks_size": FILES_IN_CHUNK,
                "data_files_size_in_mb": DATA_MB,
                "video_files_size_in_mb": VIDEO_MB,
                "fps": self._layout.fps,
                "splits": {"train": f"0:{episodes}"},
                "data_path": _DATA,
                "video_path": _VIDEO if self._layout.pictures else None,
                "features": self.features,
            },
        )
        known = {"name": self._name, "layout": self._layout.describe(), "episodes": self._described}
        _write_json(meta / "endonav.json", json.loads(as_json(known)))

    def __enter__(self) -> LeRobotWriter:
        return self

    def __exit__(self, *unused: object) -> None:
        """Every file is whole already."""


def _video_key(camera: str) -> str:
    return f"observation.images.{camera}"


def _features(layout: Layout) -> dict[str, dict[str, Any]]:
    """Describe every column as LeRobot's info.json does."""

    def numbers(names: tuple[str, ...], size: int, dtype: str = "float32") -> dict[str, Any]:
        return {"dtype": dtype, "shape": [size], "names": list(names) or None}

    state = tuple(part for name in STATE for part in layout.observations[name].parts)
    features = {"observation.state": numbers(state, len(state)), "action": numbers(layout.action.parts, 0)}
    features["action"]["shape"] = list(layout.action.shape)
    if "goal" in layout.observations:
        features["observation.environment_state"] = numbers(layout.observations["goal"].parts, 3)
    for camera, field in layout.pictures.items():
        height, width = field.shape
        features[_video_key(camera)] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.codec": CODEC,
                "video.pix_fmt": pixel_format(field.shape),
                "video.is_depth_map": False,
                "video.fps": layout.fps,
                "video.channels": 3,
                "has_audio": False,
            },
        }
    features["next.reward"] = numbers((), 1)
    features |= {f"next.{name}": numbers((), 1, "bool") for name in ("done", "truncated", "success")}
    for name in ("force", "joint_positions", "joint_velocities"):
        field = layout.observations[name]
        features[f"info.{name}"] = numbers(field.parts, field.shape[0])
    for name, field in layout.infos.items():
        features[f"info.{name}"] = numbers(field.parts, field.shape[0] if field.shape else 1)
    features["timestamp"] = numbers((), 1)
    return features | {name: numbers((), 1, dtype) for name, dtype in _COUNTERS.items()}


def _stored(features: dict[str, dict[str, Any]]) -> list[str]:
    """The features that stand in the parquet files."""
    return [name for name, feature in features.items() if feature["dtype"] != "video"]


def _columns(episode: ExportEpisode) -> dict[str, np.ndarray]:
    """The columns of an episode's steps."""
    observations, ended = episode.observations, episode.terminated | episode.truncated
    succeeded = np.zeros(episode.steps, bool)
    succeeded[-1] = episode.success
    columns = {
        "observation.state": np.concatenate([observations[name][:-1] for name in STATE], axis=1),
        "action": episode.actions,
        "next.reward": episode.rewards,
        "next.done": ended,
        "next.truncated": episode.truncated,
        "next.success": succeeded,
    }
    if "goal" in observations:
        columns["observation.environment_state"] = observations["goal"][:-1]
    columns |= {f"info.{name}": observations[name][:-1] for name in ("force", "joint_positions", "joint_velocities")}
    return columns | {f"info.{name}": values[:-1] for name, values in episode.infos.items()}


def _column(values: np.ndarray, dtype: str) -> Any:
    """A column of a table: one number a row, or a list of fixed length."""
    import pyarrow as pa

    kind = {"float32": np.float32, "int64": np.int64, "bool": np.bool_}[dtype]
    flat = pa.array(np.ascontiguousarray(values, kind).reshape(-1))
    return (
        pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim == 2 and values.shape[1] > 1 else flat
    )


def _task_table(tasks: dict[str, int]) -> Any:
    """The tasks as pandas reads them: the text is the index."""
    import pyarrow as pa

    table = pa.table({"task_index": pa.array(list(tasks.values()), pa.int64()), "task": list(tasks)})
    text = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    number = {**text, "name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"}
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": [number, text], "pandas_version": "2.0.0"}
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False, allow_nan=False), encoding="utf-8")
