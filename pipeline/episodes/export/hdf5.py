"""HDF5: every array of every log in one file, `episodes.hdf5`.

    /                       attributes: format, episodes, steps, metadata (JSON)
    /data/demo_0            one group an episode; attributes: num_samples, task, success, seed, metadata (JSON)
        actions             (n, a) float64
        rewards             (n,) float64
        dones, terminated, truncated  (n,) bool; done is either
        obs/<name>          (n + 1, ...) float64, row 0 after reset; attributes: unit, frame, meaning, parts
        obs/image/<camera>  (n + 1, height, width) uint8, and obs/mask/<camera>; compressed without loss
        infos/<name>        (n + 1,) or (n + 1, ...) float64
        log/<name>          the log's other arrays: contacts, wire points (padded with NaN) and their counts

The action of row t leads from observation t to observation t + 1.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.episodes.export.layout import ExportEpisode, ExportError, Field, Layout
from pipeline.episodes.records import as_json
from pipeline.jobs.engines.local import variables_set

FORMAT = "endonav-hdf5-1"
FILE = "episodes.hdf5"
_PICTURE_ROWS = 16  # compressed together
_TAKEN = ("action", "reward", "terminated", "truncated", "tip", "joint_positions", "joint_velocities")


class Hdf5Writer:
    """Writes episodes into `episodes.hdf5` of a folder."""

    def __init__(self, folder: Path, layout: Layout, name: str) -> None:
        """Create the file; an ExportError where h5py is not installed."""
        try:
            import h5py
        except ImportError as error:
            raise ExportError("HDF5 needs h5py: pip install 'endonav[export]'") from error
        self._layout, self._name = layout, name
        self._file = h5py.File(folder / FILE, "w")
        self._data = self._file.create_group("data")
        self._episodes = self._steps = 0

    def add(self, episode: ExportEpisode) -> None:
        group = self._data.create_group(f"demo_{self._episodes}")
        group.attrs["num_samples"] = episode.steps
        group.attrs["task"] = episode.task
        group.attrs["success"] = episode.success
        group.attrs["seed"] = episode.log.info.seed
        group.attrs["metadata"] = as_json(episode.describe())
        group.create_dataset("actions", data=episode.actions).attrs.update(_attributes(self._layout.action))
        group.create_dataset("rewards", data=episode.rewards)
        group.create_dataset("dones", data=episode.terminated | episode.truncated)
        group.create_dataset("terminated", data=episode.terminated)
        group.create_dataset("truncated", data=episode.truncated)
        for part, fields, arrays in (
            ("obs", self._layout.observations, episode.observations),
            ("infos", self._layout.infos, episode.infos),
        ):
            for name, values in arrays.items():
                group.create_dataset(f"{part}/{name}", data=values).attrs.update(_attributes(fields[name]))
        for name, values in episode.arrays.items():
            if name not in _TAKEN and not name.startswith("extra/"):
                group.create_dataset(f"log/{name}", data=values)
        for name, field in self._layout.pictures.items():
            self._add_pictures(group, name, field, episode)
        self._episodes += 1
        self._steps += episode.steps

    def _add_pictures(self, group: Any, name: str, field: Field, episode: ExportEpisode) -> None:
        kind, camera = ("mask", name.removesuffix("_mask")) if name.endswith("_mask") else ("image", name)
        rows = episode.steps + 1
        chunk = (min(_PICTURE_ROWS, rows), *field.shape)
        data = group.create_dataset(
            f"obs/{kind}/{camera}", (rows, *field.shape), np.uint8, chunks=chunk, compression="gzip", compression_opts=4
        )
        data.attrs.update(_attributes(field))
        start = 0
        for block in _blocks(episode.pictures(name), _PICTURE_ROWS):
            data[start : start + len(block)] = block
            start += len(block)

    def finish(self) -> None:
        """Write the metadata and close the file."""
        self._file.attrs["format"] = FORMAT
        self._file.attrs["episodes"] = self._episodes
        self._file.attrs["steps"] = self._steps
        self._file.attrs["metadata"] = json.dumps({"name": self._name, **self._layout.describe()})
        self._file.close()

    def __enter__(self) -> Hdf5Writer:
        return self

    def __exit__(self, *unused: object) -> None:
        self._file.close()


def _attributes(field: Field) -> Mapping[str, Any]:
    return {"unit": field.unit, "frame": field.frame, "meaning": field.meaning, "parts": json.dumps(field.parts)}


def _blocks(pictures: Iterator[np.ndarray], rows: int) -> Iterator[np.ndarray]:
    block = []
    for picture in pictures:
        block.append(picture)
        if len(block) == rows:
            yield np.stack(block)
            block = []
    if block:
        yield np.stack(block)


class MinariWriter:
    """Writes episodes as the Minari data set `<name>-v0` below a folder, one after the other."""

    def __init__(self, folder: Path, layout: Layout, name: str) -> None:
        """Prepare the writer; an ExportError where Minari is not installed."""
        try:
            import h5py  # noqa: F401
            import minari  # noqa: F401
        except ImportError as error:
            raise ExportError("Minari's format needs minari and h5py: pip install 'endonav[export]'") from error
        self._folder, self._layout, self._id = folder, layout, f"{name}-v0"
        self._dataset: Any = None
        self._described: list[dict[str, Any]] = []

    def add(self, episode: ExportEpisode) -> None:
        from minari.data_collector import EpisodeBuffer

        observations: dict[str, np.ndarray] = dict(episode.observations)
        for name in self._layout.pictures:
            observations[name] = np.stack([picture[..., None] for picture in episode.pictures(name)])
        infos = {name: np.asarray(values) for name, values in episode.infos.items()}
        infos["success"] = np.zeros(episode.steps + 1, bool)
        infos["success"][-1] = episode.success
        buffer = EpisodeBuffer(
            seed=episode.log.info.seed,
            observations=observations,
            actions=episode.actions.astype(np.float32),
            rewards=episode.rewards,
            terminations=episode.terminated,
            truncations=episode.truncated,
            infos=infos,
        )
        with variables_set({"MINARI_DATASETS_PATH": str(self._folder)}):  # where Minari writes
            if self._dataset is None:
                self._dataset = self._create(buffer)
            else:
                self._dataset.update_dataset_from_buffer([buffer])
        self._described.append(episode.describe())

    def _create(self, buffer: Any) -> Any:
        import gymnasium
        import minari

        box = gymnasium.spaces.Box
        spaces: dict[str, gymnasium.Space[Any]] = {
            name: box(-np.inf, np.inf, field.shape, np.float64) for name, field in self._layout.observations.items()
        }
        spaces |= {name: box(0, 255, (*field.shape, 1), np.uint8) for name, field in self._layout.pictures.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that there is no author, no link to code, no environment
            return minari.create_dataset_from_buffers(
                self._id,
                [buffer],
                observation_space=gymnasium.spaces.Dict(spaces),
                action_space=box(-1.0, 1.0, self._layout.action.shape, np.float32),
                description="Endovascular navigation; units and frames of every field stand in endonav_layout.",
                requirements=["endonav-cathsim"],
                jpeg_encoding=False,
            )

    def finish(self) -> None:
        """Write what is known of fields and episodes."""
        storage = self._dataset.storage
        storage.update_metadata({"endonav_layout": as_json(self._layout.describe())})
        metadata = [
            {"task": one["task"], "success": bool(one["success"]), "endonav": as_json(one)} for one in self._described
        ]
        storage.update_episode_metadata(metadata)

    def __enter__(self) -> MinariWriter:
        return self

    def __exit__(self, *unused: object) -> None:
        """Every episode is on the disk already."""
