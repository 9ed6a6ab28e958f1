"""The report's table of what a load cell reads, by phantom, target, device and operator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.evaluations.device_table import without_device
from pipeline.evaluations.load_cell import QUANTITIES
from pipeline.evaluations.logs import Evaluation
from pipeline.tables import SAMPLES, Table


def load_cell_table(rows: Mapping[tuple[str, str, str, str], Sequence[Evaluation]]) -> Table:
    """Mean and standard deviation over all steps of every operator, by phantom, target and device.

    Args:
        rows: evaluations by stage, phantom, target and row.
    """
    table: Table = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        for device in sorted({one.device for one in evaluations}):
            chosen = [one for one in evaluations if one.device == device and one.wall_forces is not None]
            if not chosen:
                continue
            weights = np.array([one.metrics.steps for one in chosen], float)
            cells: dict[str, Any] = {SAMPLES: len(chosen)}
            for quantity in QUANTITIES:
                moments = np.array([(one.wall_forces or {})[quantity] for one in chosen])
                mean, square = np.average(moments, axis=0, weights=weights)
                cells[quantity] = [float(mean), float(np.sqrt(max(square - mean**2, 0.0)))]
            table[f"{phantom}/{target}/{device}/{stage}/{without_device(name, device)}"] = cells
    return table
