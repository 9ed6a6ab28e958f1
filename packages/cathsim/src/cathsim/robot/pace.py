"""How often an operator decides, and how far the feeders move between two decisions."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Interval

from cathsim.validation import Unit, settings

CONTROL_STEP = 0.1  # s
TRANSLATION_STEP = 0.002  # m at full action
ROTATION_STEP = np.radians(15.0)  # rad at full action


@settings
class Pace:
    """The control step of a simulation and what full actions move in it.

    Attributes:
        interval: between two decisions, s.
        translation: of a feeder at full action, m a decision.
        rotation: of a feeder at full action, rad a decision.
    """

    interval: Annotated[float, Interval(ge=0.01, le=1.0), Unit("s")] = CONTROL_STEP
    translation: Annotated[float, Interval(gt=0, le=0.02), Unit("m")] = TRANSLATION_STEP
    rotation: Annotated[float, Interval(gt=0, le=math.pi), Unit("rad")] = ROTATION_STEP


# 7.5 decisions a second, 35 mm/s and 180 degrees/s; source: as of `arch_variety.task`
PACES = {"usual": Pace(), "arch_variety": Pace(1 / 7.5, 0.035 / 7.5, math.pi / 7.5)}


def named_pace(name: str) -> Pace:
    """The pace of that name.

    Raises:
        ValueError: there is none.
    """
    if name not in PACES:
        raise ValueError(f"unknown pace '{name}'; there are {', '.join(PACES)}")
    return PACES[name]
