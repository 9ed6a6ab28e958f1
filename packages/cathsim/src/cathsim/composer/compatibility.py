"""What dm_control 1.0.50 needs on MuJoCo 4.0: it asks models for array fields that MuJoCo has dropped."""

from __future__ import annotations

import mujoco
from dm_control.mujoco.wrapper.mjbindings import sizes

_OWNERS = {"mjmodel": mujoco.MjModel, "mjdata": mujoco.MjData}


def dropped_fields() -> dict[str, list[str]]:
    """Array fields that dm_control lists and this MuJoCo lacks, by the name of the struct; empty once both agree."""
    return {
        struct: [name for name in sizes.array_sizes[struct] if not hasattr(owner, name)]
        for struct, owner in _OWNERS.items()
    }


def forget_dropped_fields() -> None:
    """Takes those fields off dm_control's list, from which a Physics makes its named indexers; safe to call again."""
    for struct, names in dropped_fields().items():
        for name in names:
            del sizes.array_sizes[struct][name]
