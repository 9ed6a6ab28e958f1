"""Minari: a data set that `minari.load_dataset` reads, made by Minari itself.

Observations are a `Dict` of the layout's fields, float64, and of pictures, (height, width, 1) uint8, stored without
loss; infos have the same number of rows as observations, `success` among them.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from pipeline.episodes.export.layout import ExportEpisode, ExportError, Layout
from pipeline.episodes.records import as_json

_FOLDER_VARIABLE = "MINARI_DATASETS_PATH"


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
        """Write an episode."""
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
        with _datasets_in(self._folder):
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        return None


@contextmanager
def _datasets_in(folder: Path) -> Iterator[None]:
    """Lets Minari, which knows its folder by a variable of the environment, write below another folder."""
    before = os.environ.get(_FOLDER_VARIABLE)
    os.environ[_FOLDER_VARIABLE] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[_FOLDER_VARIABLE]
        else:
            os.environ[_FOLDER_VARIABLE] = before
