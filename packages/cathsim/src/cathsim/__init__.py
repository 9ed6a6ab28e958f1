"""Real-time simulation of a guidewire in an aorta, with environments for learning to steer it.

`gymnasium.make("cathsim/Navigate-v0")` is the usual way in; see `cathsim.environment.NavigateEnv`. Names are imported
at first use, so that `import cathsim` stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cathsim.lazy_names import lazy_names
from cathsim.registration import ENVIRONMENT as ENVIRONMENT
from cathsim.registration import register

if TYPE_CHECKING:
    from cathsim.anatomy import PHANTOMS as PHANTOMS
    from cathsim.anatomy import Phantom as Phantom
    from cathsim.anatomy import import_anatomy as import_anatomy
    from cathsim.anatomy import load_phantom as load_phantom
    from cathsim.devices.catheter import Catheter as Catheter
    from cathsim.devices.shelf import CATHETERS as CATHETERS
    from cathsim.devices.shelf import load_catheter as load_catheter
    from cathsim.environment import NavigateEnv as NavigateEnv
    from cathsim.guidewire import GUIDEWIRES as GUIDEWIRES
    from cathsim.guidewire import Guidewire as Guidewire
    from cathsim.guidewire import load_guidewire as load_guidewire
    from cathsim.navigation import NavigationTask as NavigationTask
    from cathsim.presets import ACCURACY as ACCURACY
    from cathsim.presets import Accuracy as Accuracy
    from cathsim.simulation import Simulation as Simulation
    from cathsim.vector import ThreadedVectorEnv as ThreadedVectorEnv

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "anatomy": "PHANTOMS Phantom import_anatomy load_phantom",
        "devices.catheter": "Catheter",
        "devices.shelf": "CATHETERS load_catheter",
        "environment": "NavigateEnv",
        "guidewire": "GUIDEWIRES Guidewire load_guidewire",
        "navigation": "NavigationTask",
        "presets": "ACCURACY Accuracy",
        "registration": "ENVIRONMENT",
        "simulation": "Simulation",
        "vector": "ThreadedVectorEnv",
    },
)

register()
