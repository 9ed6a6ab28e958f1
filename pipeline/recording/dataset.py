"""Episode logs as a data set of torch: windows of steps, with the fields and pictures that are wanted."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset

from pipeline.episodes import EpisodeInfo, EpisodeOutcome, EpisodeReader, StepRecord
from pipeline.episodes.encoding.schema import DEVICE_FIELDS, STEP_FIELDS
from pipeline.episodes.export.exporting import logs_below
from pipeline.episodes.export.layout import ExportError, Layout, common_layout, info_values, observation_values

STEP_FIELDS_OF_ITEMS = ("action", "reward", "terminated", "truncated")
_RAGGED = ("wire_points", "contact_positions", "contact_forces", "catheter_points")
_OPEN_LOGS = 16  # of a process

Where = Callable[[EpisodeInfo, EpisodeOutcome], bool]
ImageTransform = Callable[[torch.Tensor], torch.Tensor]


@dataclass(frozen=True)
class IndexedEpisode:
    """A log of a data set: its file, how many actions it has, and its target."""

    path: Path
    steps: int
    goal: NDArray[np.float64] | None  # (3,), m, world


class EpisodeDataset(Dataset[dict[str, torch.Tensor]]):
    """Windows of the episodes in a folder and below it, read from the logs when they are asked for.

    The logs are indexed once, when the data set is made; workers of a `DataLoader` get the index and open the logs that
    they read themselves. An item is a dictionary of tensors, the first axis being the window's steps:

    | key | shape | |
    |---|---|---|
    | a field of the layout, such as `tip` | (window, ...) float32 | the observation, or info, before the action |
    | `action` | (window, a) float32 | the action |
    | `reward` | (window,) float32 | what followed the action |
    | `terminated`, `truncated` | (window,) bool | how it ended the episode |
    | `image/<camera>`, `mask/<camera>` | (window, 1, height, width) | float32 0 to 1, or what the transform gives |
    | `episode`, `step` | () int64 | number of the episode, first step of the window |
    | `pad` | (window,) bool | with `pad`: steps after the episode's end, which repeat the last one |

    Args:
        folder: with logs (`*.mcap`).
        fields: which of them; units and frames are those of `pipeline.episodes.export.layout`.
        window: steps in an item.
        stride: steps between the starts of two windows.
        pad: also windows that reach beyond the end; without, episodes shorter than a window are left out.
        image_transform: takes images and masks, (window, 1, height, width) uint8; None: float32 from 0 to 1.
        where: says from information and outcome whether an episode is taken, e.g.
            lambda info, outcome: outcome.success is True.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        fields: Sequence[str] = ("tip", "feeder", *STEP_FIELDS_OF_ITEMS),
        *,
        window: int = 1,
        stride: int = 1,
        pad: bool = False,
        image_transform: ImageTransform | None = None,
        where: Where | None = None,
    ) -> None:
        for name, value in (("window", window), ("stride", stride)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ExportError(f"{name} must be a whole number of at least 1, got {value!r}")
        self.fields, self.window, self.stride, self.pad = tuple(fields), window, stride, pad
        self._transform = image_transform
        paths = [path for path in logs_below(Path(folder)) if where is None or _taken(path, where)]
        if not paths:
            raise ExportError(f"no episode in {folder} is taken: `where` refuses all of them")
        streams = [name for name in self.fields if "/" in name]
        self.layout = common_layout(
            paths, pictures=bool(streams), masks=any(name.startswith("mask/") for name in streams)
        )
        self._check_fields(folder)
        self.episodes = tuple(_indexed(path, goal="goal" in self.fields) for path in paths)
        counts = [self._windows(episode.steps) for episode in self.episodes]
        self._ends = np.cumsum(counts)
        if not self._ends[-1]:
            longest = max(episode.steps for episode in self.episodes)
            raise ExportError(
                f"no episode has {window} steps, the longest has {longest}: take a shorter window, or pad=True"
            )
        self._readers: OrderedDict[int, EpisodeReader] = OrderedDict()
        self._process = os.getpid()

    def _check_fields(self, folder: str | os.PathLike[str]) -> None:
        known = available_fields(self.layout)
        missing = [name for name in self.fields if name not in known]
        if missing or not self.fields:
            raise ExportError(
                f"the logs in {folder} have no {', '.join(missing) or 'fields that were asked for'}; "
                f"there are {', '.join(known)}"
            )

    def _windows(self, steps: int) -> int:
        last = steps - 1 if self.pad else steps - self.window
        return max(0, last // self.stride + 1)

    def __len__(self) -> int:
        return int(self._ends[-1])

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        """Read a window; the last one is -1."""
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"there is no window {index}: there are {count}")
        index %= count
        number = int(np.searchsorted(self._ends, index, side="right"))
        before = int(self._ends[number - 1]) if number else 0
        return self._read(number, (index - before) * self.stride)

    def _read(self, number: int, first: int) -> dict[str, torch.Tensor]:
        episode, log = self.episodes[number], self._reader(number)
        steps = np.minimum(np.arange(first, first + self.window), episode.steps - 1)
        records = {step: log.step(step) for step in range(first, int(steps[-1]) + 2)}
        now = stacked([records[int(step)] for step in steps])
        then = stacked([records[int(step) + 1] for step in steps])
        observations = observation_values(now, episode.goal)
        item: dict[str, torch.Tensor] = {}
        for name in self.fields:
            if name in STEP_FIELDS_OF_ITEMS:
                item[name] = _tensor(then[name])
            elif "/" in name:
                item[name] = self._pictures(log, name, steps)
            else:
                item[name] = _tensor(observations[name] if name in observations else info_values(name, now))
        item["episode"], item["step"] = torch.tensor(number), torch.tensor(first)
        if self.pad:
            item["pad"] = torch.arange(first, first + self.window) >= episode.steps
        return item

    def _pictures(self, log: EpisodeReader, name: str, steps: NDArray[np.int64]) -> torch.Tensor:
        kind, _, camera = name.partition("/")
        if kind == "image":
            pictures = [log.image(camera, int(step)) for step in steps]
        else:
            pictures = [log.mask(camera, int(step)).astype(np.uint8) * np.uint8(255) for step in steps]
        tensor = torch.from_numpy(np.stack(pictures)[:, None])
        return tensor.float() / 255.0 if self._transform is None else self._transform(tensor)

    def _reader(self, number: int) -> EpisodeReader:
        """The reader of an episode; a process that was forked opens its own."""
        if self._process != os.getpid():
            self._readers, self._process = OrderedDict(), os.getpid()
        if number not in self._readers:
            self._readers[number] = EpisodeReader(self.episodes[number].path)
            if len(self._readers) > _OPEN_LOGS:
                self._readers.popitem(last=False)[1].close()
        self._readers.move_to_end(number)
        return self._readers[number]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_readers": OrderedDict()}

    def close(self) -> None:
        """Close the logs that are open; reading opens them again."""
        for reader in self._readers.values():
            reader.close()
        self._readers.clear()


def available_fields(layout: Layout) -> tuple[str, ...]:
    """Names of the fields that items can have."""
    pictures = [
        f"mask/{name.removesuffix('_mask')}" if name.endswith("_mask") else f"image/{name}" for name in layout.pictures
    ]
    return (*layout.observations, *layout.infos, *STEP_FIELDS_OF_ITEMS, *pictures)


def stacked(records: Sequence[StepRecord]) -> dict[str, NDArray[Any]]:
    """The records' fields of fixed shape as arrays, as `EpisodeReader.load_arrays` names them."""
    fixed = [name for name in STEP_FIELDS if name not in _RAGGED and name != "step"]
    arrays = {name: np.array([getattr(record, name) for record in records]) for name in fixed}
    for key in records[0].extra:
        arrays[f"extra/{key}"] = np.array([record.extra.get(key, np.nan) for record in records])
    if records[0].devices is not None:
        for name in DEVICE_FIELDS:
            if name not in _RAGGED and name != "step":
                arrays[f"devices/{name}"] = np.array([getattr(record.devices, name) for record in records])
    return arrays


def _tensor(values: NDArray[Any]) -> torch.Tensor:
    return torch.from_numpy(values if values.dtype == np.bool_ else values.astype(np.float32))


def _taken(path: Path, where: Where) -> bool:
    with EpisodeReader(path) as log:
        return where(log.info, log.outcome)


def _indexed(path: Path, *, goal: bool) -> IndexedEpisode:
    with EpisodeReader(path) as log:
        mesh = log.phantom_mesh() if goal else None
        return IndexedEpisode(path, log.last_step, None if mesh is None else np.asarray(mesh.target, np.float64))
