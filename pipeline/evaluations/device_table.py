"""The report's table of devices: success, steps and forces of an operator with the wire alone and in catheters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.evaluations.load_cell import WIRE
from pipeline.evaluations.logs import Evaluation, Task
from pipeline.evaluations.statistics import summary
from pipeline.tables import SAMPLES, Table

_COLUMNS = ("success_pct", "episode_length_steps", "path_length_cm", "force_n", "force_max_n")
_DEVICES = ("wire", "catheter")  # as `Evaluation.feeder_forces` has them


def with_device(row: str, device: str) -> str:
    """A row's name, with the catheter in brackets where there is one."""
    return row if device == WIRE else f"{row} ({device})"


def without_device(row: str, device: str) -> str:
    """What `with_device` was given."""
    return row.removesuffix(with_device("", device))


def device_table(
    rows: Mapping[tuple[str, str, str, str], Sequence[Evaluation]], shortest: Mapping[Task, float]
) -> Table:
    """A line for each device with which an operator steered to a target; none where all steered the wire alone.

    Args:
        rows: deterministic evaluations by stage, phantom, target and row, whose name has the catheter.
        shortest: from `shortest_paths`.

    Returns:
        Row ``phantom/target/stage/row/device``: means and standard deviations over the episodes; forces of the feeders
        are magnitudes, the largest over all steps.
    """
    lines: dict[tuple[str, str, str, str], dict[str, Sequence[Evaluation]]] = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        if evaluations:
            device = evaluations[0].device
            operator = phantom, target, stage, without_device(name, device)
            lines.setdefault(operator, {})[device] = evaluations
    return {
        "/".join((*operator, device)): _line(evaluations, shortest)
        for operator, devices in lines.items()
        if set(devices) != {WIRE}
        for device, evaluations in sorted(devices.items(), key=lambda item: (item[0] != WIRE, item[0]))
    }


def _line(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Any]:
    values = summary(evaluations, shortest)
    cells: dict[str, Any] = {column: values[column] for column in _COLUMNS}
    pushed = [one.feeder_forces for one in evaluations if one.feeder_forces is not None]
    for index, device in enumerate(_DEVICES if pushed else ()):
        means, largest = [one[0][index] for one in pushed], [one[1][index] for one in pushed]
        cells[f"{device}_feeder_n"] = [float(np.mean(means)), float(np.std(means))]
        cells[f"{device}_feeder_max_n"] = float(max(largest))
    return {**cells, SAMPLES: len(evaluations)}
