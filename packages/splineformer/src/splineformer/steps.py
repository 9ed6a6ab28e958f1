"""Steps along a wire for the walker to learn: places near it, directions, the way to the next point or to the tip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.polyline import arc_length, at_length

COUNT = 40  # places of an image
STEP_CELLS = 2.0
_NEAR_TIP = 8  # of the places
_NEAR_STEPS = 2.5  # steps before the tip in which those lie
_AT_END = 2  # places where the walk begins
_ASIDE_CELLS = 0.7  # standard deviation of a place from the wire
_TURN_RAD = 0.2  # and of the direction from the wire's

Array = NDArray[np.float64]


def steps_along(curve: Array, cell: float, generator: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Draws places along a curve and tells what to do there.

    Args:
        curve: (n, 2) dense, tip first, shares of the side.
        cell: share of the side.
        generator: of the draws.

    Returns:
        (COUNT, 2) places; (COUNT, 2) directions towards the tip; (COUNT, 2) ways along and across them, in cells, to
        the point a step further or to the tip; (COUNT,) 1 where the tip lies within the step.
    """
    length, step = float(arc_length(curve)[-1]), STEP_CELLS * cell
    at = generator.uniform(0.0, length, COUNT)
    at[:_NEAR_TIP] = generator.uniform(0.0, min(_NEAR_STEPS * step, length), _NEAR_TIP)
    at[_NEAR_TIP : _NEAR_TIP + _AT_END] = length
    places, ahead = at_length(curve, at), at_length(curve, np.maximum(at - step, 0.0))
    came = places - at_length(curve, np.minimum(at + step, length))
    still = np.linalg.norm(came, axis=1) < 1e-9
    came[still] = (ahead - places)[still]
    directions = came / np.maximum(np.linalg.norm(came, axis=1, keepdims=True), 1e-12)
    across = np.column_stack([-directions[:, 1], directions[:, 0]])
    places = places + across * (_ASIDE_CELLS * cell * generator.standard_normal((COUNT, 1)))
    turn = _TURN_RAD * generator.standard_normal((COUNT, 1))
    directions, across = (
        np.cos(turn) * directions + np.sin(turn) * across,
        np.cos(turn) * across - np.sin(turn) * directions,
    )
    way = (ahead - places) / cell
    ways = np.column_stack([(way * directions).sum(axis=1), (way * across).sum(axis=1)])
    return places, directions, ways, (at <= step).astype(np.float64)
