"""Demonstrations in files: an ``.npz`` an episode, with everything that an `enn.trajectory.Trajectory` holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from enn.trajectory import Trajectory

ARRIVED = "terminated"  # name in the file: whether the target was reached


def demonstration_arrays(shown: Trajectory) -> dict[str, Any]:
    """The arrays of an episode by their names in the file; of one that did not arrive, only that."""
    if not shown.terminated:
        return {ARRIVED: np.array(False)}
    return {
        **shown.observations,
        "actions": shown.actions,
        "rewards": shown.rewards,
        ARRIVED: np.array(True),
        "forces": shown.forces,
        "tips": shown.tips,
        "states": shown.simulation_states,
    }


def arrived(path: Path) -> bool:
    """Whether the episode of a file reached its target."""
    with np.load(path) as arrays:
        return bool(arrays[ARRIVED])


def read_demonstration(path: Path, keys: Sequence[str], **metadata: Any) -> Trajectory | None:
    """The episode of a file; None: it did not reach its target.

    Args:
        keys: of its observations.
        metadata: kept beside the path.
    """
    from enn.trajectory import Trajectory

    with np.load(path) as arrays:
        if not arrays[ARRIVED]:
            return None
        return Trajectory(
            {key: arrays[key] for key in keys},
            arrays["actions"],
            arrays["rewards"],
            True,
            arrays["forces"],
            arrays["tips"],
            arrays["states"],
            {"file": str(path), **metadata},
        )
