"""The dm_control composer environment: the same vessel, wire and task as `NavigateEnv`, as composer entities.

```python
from cathsim import composer

environment = composer.load(phantom="type_1", target="bca", seed=0)
timestep = environment.reset()
timestep = environment.step(environment.action_spec().maximum)
```

It needs dm_control: `pip install "endonav-cathsim[composer]"`.
"""

from __future__ import annotations

try:
    import dm_control.composer  # noqa: F401
except ModuleNotFoundError as error:
    if error.name is None or error.name.split(".")[0] not in ("dm_control", "dm_env"):
        raise
    raise ImportError(
        'cathsim.composer needs dm_control: install it with pip install "endonav-cathsim[composer]"'
    ) from error

import mujoco
from dm_control.mujoco.wrapper.mjbindings import sizes


def _forget_dropped_fields() -> None:
    """Takes array fields that MuJoCo 4.0 lacks off the list from which dm_control 1.0.50 makes named indexers."""
    for struct, owner in (("mjmodel", mujoco.MjModel), ("mjdata", mujoco.MjData)):
        for name in [name for name in sizes.array_sizes[struct] if not hasattr(owner, name)]:
            del sizes.array_sizes[struct][name]


_forget_dropped_fields()

from cathsim.composer.entities import Feeder, GuidewireEntity, VesselArena  # noqa: E402
from cathsim.composer.navigate import STEPPING, NavigateTask, load  # noqa: E402

__all__ = ["STEPPING", "Feeder", "GuidewireEntity", "NavigateTask", "VesselArena", "load"]
