"""Motion primitives of an operator: what a hand does with one device or two before it looks again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EMERGED, BEYOND = 0.010, 0.035  # m of wire in front of the catheter
_FIRST = 10  # steps in which the catheter is moved first, by these translations and rotations
_CATHETER_FIRST = ((0.0, 0.0), (0.0, 0.5), (0.0, -0.5), (0.0, 1.0), (-1.0, 0.0), (-1.0, 0.5), (-1.0, -0.5))
# Translation and rotation of the wire, or of wire and catheter, of the most in a step: first half, then second half.
_WIRE = (
    ((0, 1), (1, 0)),
    ((0, -1), (1, 0)),
    ((1, 0.5), (1, 0.5)),
    ((1, -0.5), (1, -0.5)),
    ((1, 1), (1, 1)),
    ((1, -1), (1, -1)),
    ((-1, 0), (-1, 0)),
    ((-1, 0.5), (1, 0.5)),
    ((-1, -0.5), (1, -0.5)),
    ((-1, 1), (1, 0)),
    ((-1, -1), (1, 0)),
)
_TWO_DEVICES = (
    ((1, 0, 0, 0), (1, 0, 0, 0)),  # the wire goes ahead
    ((1, 0.7, 0, 0), (1, 0.7, 0, 0)),
    ((1, -0.7, 0, 0), (1, -0.7, 0, 0)),
    ((0, 0, 1, 0), (0, 0, 1, 0)),  # the catheter follows over it
    ((-1, 0, 0, 0), (1, 0, 0, 0)),  # the wire is drawn back, and out again
    ((-1, 0, 1, 0), (-1, 0, 1, 0)),  # the catheter's shape returns
    ((0, 0, 0, 1), (1, 0, 0, 0)),  # the catheter is turned, then the wire goes ahead
    ((0, 0, 0, -1), (1, 0, 0, 0)),
    ((0, 0, 0, 0.7), (1, 0, 1, 0.7)),
    ((0, 0, 0, -0.7), (1, 0, 1, -0.7)),
    ((0, 0, -1, 0), (1, 0, 0, 0)),  # the catheter is drawn back, as a reverse curve is to engage
    ((-1, 0, -1, 0), (1, 0, 0, 0)),  # both are drawn back, then the wire goes ahead
    ((-1, 0, -1, 0.5), (1, 0, 0, 0)),
    ((-1, 0, -1, -0.5), (1, 0, 0, 0)),
)


def motion_primitives(actions: int, horizon: int) -> NDArray[np.float64]:
    """Plans of an operator's motions.

    Args:
        actions: 2 for the wire, 4 for wire and catheter.
        horizon: length of a plan, control steps.

    Returns:
        Shape (k, horizon, actions), shares of the largest movement in a step.
    """
    halves = np.array(_WIRE if actions == 2 else _TWO_DEVICES, np.float64)
    return np.repeat(halves, [horizon - horizon // 2, horizon // 2], axis=1)


def wire_advances(lead: float, step: float) -> NDArray[np.float64]:
    """Plans that bring the wire out of the catheter and on, which no plan of a few steps would see the end of.

    Args:
        lead: how far the wire is ahead of the catheter, m; from `EMERGED` on there are no plans.
        step: largest translation in a step, m.

    Returns:
        Shape (k, steps, 4): the catheter is turned, or drawn back, or left; then the wire goes `BEYOND` its tip.
    """
    firsts = _CATHETER_FIRST if lead < EMERGED else ()
    pushes = int(np.ceil((BEYOND - lead) / step)) if firsts else 0
    plans = np.zeros((len(firsts), _FIRST + pushes, 4))
    plans[:, _FIRST:, 0] = 1.0
    for plan, motion in zip(plans, firsts, strict=True):
        plan[:_FIRST, 2:] = motion
    return plans
