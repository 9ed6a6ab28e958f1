"""Real-time simulation of a guidewire in an aorta, with environments for learning to steer it.

`gymnasium.make("cathsim/Navigate-v0")` is the usual way in; see `cathsim.environment.NavigateEnv`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from cathsim.registration import ENVIRONMENT, register

if TYPE_CHECKING:
    from cathsim.anatomy import PHANTOMS, Phantom, import_anatomy, load_phantom
    from cathsim.devices.catheter import Catheter
    from cathsim.devices.shelf import CATHETERS, load_catheter
    from cathsim.environment import NavigateEnv
    from cathsim.guidewire import GUIDEWIRES, Guidewire, load_guidewire
    from cathsim.navigation import NavigationTask
    from cathsim.presets import ACCURACY, Accuracy
    from cathsim.simulation import Simulation
    from cathsim.vector import ThreadedVectorEnv

__version__ = "0.1.0"

_HOME = {
    "PHANTOMS": "anatomy",
    "Phantom": "anatomy",
    "import_anatomy": "anatomy",
    "load_phantom": "anatomy",
    "Catheter": "devices.catheter",
    "CATHETERS": "devices.shelf",
    "load_catheter": "devices.shelf",
    "NavigateEnv": "environment",
    "GUIDEWIRES": "guidewire",
    "Guidewire": "guidewire",
    "load_guidewire": "guidewire",
    "NavigationTask": "navigation",
    "ACCURACY": "presets",
    "Accuracy": "presets",
    "Simulation": "simulation",
    "ThreadedVectorEnv": "vector",
}

__all__ = [
    "ACCURACY",
    "CATHETERS",
    "ENVIRONMENT",
    "GUIDEWIRES",
    "PHANTOMS",
    "Accuracy",
    "Catheter",
    "Guidewire",
    "NavigateEnv",
    "NavigationTask",
    "Phantom",
    "Simulation",
    "ThreadedVectorEnv",
    "import_anatomy",
    "load_catheter",
    "load_guidewire",
    "load_phantom",
]

register()


def __getattr__(name: str) -> Any:
    # imported at first use, so that `import cathsim` stays light
    if name in _HOME:
        return getattr(importlib.import_module(f"cathsim.{_HOME[name]}"), name)
    raise AttributeError(f"module 'cathsim' has no attribute '{name}'")
