"""The arrays of an episode: its records and pictures stacked along a first axis, all of one count."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.episodes.encoding.schema import DEVICE_FIELDS, DEVICE_MASKS, STEP_FIELDS, STEP_TOPIC
from pipeline.episodes.records import damaged

_MOST_POINTS = 1 << 26  # of a ragged field stacked over an episode: 1.5 GB
_RAGGED = {
    "wire_points": "wire_count",
    "contact_positions": "contact_count",
    "contact_forces": "contact_count",
    "devices/wire_points": "devices/wire_count",
    "devices/catheter_points": "devices/catheter_count",
}


def stacked(log: Any, *, pictures: bool) -> dict[str, NDArray[Any]]:
    """Stack a whole episode of an `EpisodeReader`: see its `load_arrays`."""
    records = list(log) if log.holds(STEP_TOPIC) else []
    if not records:
        raise damaged(log.path, "it holds no step")
    steps = np.array([record.step for record in records], dtype=np.int64)
    arrays: dict[str, NDArray[Any]] = {"step": steps}
    arrays["time_s"] = steps * log.info.interval_ns * 1e-9
    columns = {name: [getattr(record, name) for record in records] for name in STEP_FIELDS if name != "step"}
    if log.info.has_catheter:
        of_devices = [name for name in DEVICE_FIELDS if name != "step"]
        columns |= {f"devices/{name}": [getattr(one.devices, name) for one in records] for name in of_devices}
    for name, values in columns.items():
        if name in _RAGGED:
            counts = np.array([len(value) for value in values])
            if counts.max() * len(values) > _MOST_POINTS:
                raise damaged(log.path, f"a step holds {counts.max()} {name}, too many to stack {len(values)}")
            padded = np.full((len(values), counts.max(), 3), np.nan)
            for row, value in zip(padded, values, strict=True):
                row[: len(value)] = value
            arrays[name], arrays[_RAGGED[name]] = padded, counts
        else:
            arrays[name] = _stack(log, name, [np.asarray(value) for value in values])
    for key in dict.fromkeys(key for record in records for key in record.extra):
        arrays[f"extra/{key}"] = np.array([record.extra.get(key, np.nan) for record in records])
    for camera in log.cameras if pictures else ():
        for stream in filter(partial(log.has, camera), ("image", "mask", *DEVICE_MASKS)):
            images = dict(log.pictures(camera, stream))
            if list(images) != steps.tolist():
                raise damaged(log.path, f"camera {camera} has {len(images)} {stream}s for {len(records)} records")
            arrays[f"{stream}/{camera}"] = np.stack(list(images.values()))
    return arrays


def _stack(log: Any, name: str, values: list[NDArray[Any]]) -> NDArray[Any]:
    """Stack what must be of one shape."""
    if not values:
        raise damaged(log.path, f"it holds no {name}")
    shapes = dict.fromkeys(value.shape for value in values)
    if len(shapes) > 1:
        raise damaged(log.path, f"{name} changes its shape from step to step: {', '.join(map(str, shapes))}"[:300])
    return np.stack(values)
