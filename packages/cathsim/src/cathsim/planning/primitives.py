"""Motion primitives of an operator: what a hand does with one device or two before it looks again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
