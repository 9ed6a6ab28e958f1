"""Laying a simulated device along a curve, its feeders as given: joint angles whose links point along it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.devices.arena import FEEDER, PROTRUSION
from cathsim.devices.simulation import DualSimulation
from cathsim.simulation import Simulation
from cathsim.statics.observed_curve import ObservedCurve
from cathsim.statics.uncertainty import Deviation

Array = NDArray[np.float64]

ANGLES = 12  # tried around the circle
NEAR = 0.15  # rad from the last frame's rotation that are tried
_REST_STEPS = 3  # control steps before a trial is judged
_HALVINGS = 3  # of the angle between trials, around the best


@dataclass(frozen=True)
class Feeder:
    """Positions of the feeders."""

    insertion: float  # of the wire, or of the only device, m
    rotation: float  # of its hub, rad
    catheter: tuple[float, float] | None = None  # insertion (m) and rotation (rad) of a catheter over the wire

    @property
    def furthest(self) -> float:
        """Insertion of the device that is further in, m."""
        return max(self.insertion, self.catheter[0]) if self.catheter else self.insertion

    def deviating(self, case: Deviation, limit: float) -> Feeder:
        """With the errors of a case, those of a catheter being the wire's; insertions lie in 0 to `limit` (m)."""
        first = (_within(self.insertion + case.insertion, limit), self.rotation + case.rotation)
        if self.catheter is None:
            return Feeder(*first)
        second = (_within(self.catheter[0] + case.insertion, limit), self.catheter[1] + case.rotation)
        return Feeder(*first, second)

    def moves_from(self, last: Feeder) -> tuple[tuple[float, float], tuple[float, float]]:
        """Translation (m) and rotation (rad) since a last position: of the wire, and of the catheter."""
        wire = (self.insertion - last.insertion, self.rotation - last.rotation)
        if self.catheter is None or last.catheter is None:
            return wire, (0.0, 0.0)
        return wire, (self.catheter[0] - last.catheter[0], self.catheter[1] - last.catheter[1])


def checked_catheter(catheter: tuple[float, float], limit: float) -> tuple[float, float]:
    """Checks a catheter's insertion (m) and rotation (rad).

    Raises:
        ValueError: not two finite numbers, or an insertion out of 0 to `limit` (m).
    """
    try:
        insertion, rotation = (float(value) for value in catheter)
    except (TypeError, ValueError):
        raise ValueError(f"catheter must be an insertion (m) and a rotation (rad), got {catheter!r}") from None
    if not (math.isfinite(insertion) and math.isfinite(rotation) and 0 <= insertion <= limit):
        raise ValueError(
            f"the catheter's insertion must lie in 0 to {limit:.3f} m and its rotation be finite, got {catheter!r}"
        )
    return insertion, rotation


def checked_number(name: str, value: float, unit: str) -> float:
    """Refuses with a `ValueError` what is no number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number ({unit}), got {value!r}") from None


def _within(insertion: float, limit: float) -> float:
    return min(max(insertion, 0.0), limit)


def joint_angles(nodes: Array, axes: Array) -> Array:
    """The two angles of each joint that turn the links of a chain along a polyline.

    Args:
        nodes: ends of the links behind the first, which is held, from the proximal end, m. Shape (k + 1, 3).
        axes: of the first link, its z along it, in columns. Shape (3, 3).

    Returns:
        Shape (k, 2), rad: about a link's x, then about its new y.
    """
    bends = np.empty((len(nodes) - 1, 2))
    for joint, (start, end) in enumerate(itertools.pairwise(nodes)):
        along = axes.T @ ((end - start) / np.linalg.norm(end - start))
        bends[joint] = np.arctan2(-along[1], along[2]), np.arcsin(np.clip(along[0], -1.0, 1.0))
        axes = axes @ _turned(*bends[joint])
    return bends


def lay_along(simulation: Simulation, curve: ObservedCurve, feeder: Feeder) -> None:
    """Lays the device along a curve, without a velocity; what is not inserted lies straight in the sheath.

    The curve is stretched to the inserted length. Links keep its directions, so that a curve beside the entry is moved
    to it.
    """
    if isinstance(simulation, DualSimulation):  # sets lead and hubs, which stay when the chain is moved
        _reset_pair(simulation, feeder)
    straight = np.zeros(simulation.nq)
    straight[:2] = feeder.furthest, feeder.rotation
    simulation.set_joint_positions(straight)
    links = np.asarray(simulation.wire.links[-simulation.active_links :])
    from_tip = np.concatenate((np.cumsum(links[::-1])[::-1], [0.0]))
    length = feeder.furthest + PROTRUSION
    behind = np.maximum(from_tip - length, 0.0)
    nodes = curve.at(from_tip, length) - behind[:, None] * simulation.vessel.direction
    axes = simulation.data.xmat[simulation.model.body(FEEDER).id].reshape(3, 3).copy()
    bends = joint_angles(nodes[1:], axes).ravel()
    straight[len(straight) - len(bends) :] = bends
    simulation.set_joint_positions(straight)


def _reset_pair(simulation: DualSimulation, feeder: Feeder) -> None:
    """Puts both devices as far apart as they are, as little inserted as that allows."""
    if feeder.catheter is None:
        simulation.reset(0.0, feeder.rotation)
        return
    lead = feeder.insertion - feeder.catheter[0]
    simulation.reset(max(lead, 0.0), feeder.rotation, catheter=(max(-lead, 0.0), feeder.catheter[1]))


def distance_to(simulation: Simulation, curve: ObservedCurve) -> float:
    """Root mean square distance (m) between the device and a curve, at equal distances from their tips."""
    points = simulation.inserted_points()
    from_tip = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    inserted = from_tip <= curve.length
    gaps = points[inserted] - curve.at(from_tip[inserted])
    weights = np.gradient(from_tip[inserted]) if inserted.sum() > 1 else np.ones(1)
    return float(np.sqrt((weights * (gaps**2).sum(axis=1)).sum() / weights.sum()))


def _turned(about_x: float, about_y: float) -> Array:
    """Rotation about x, then about the new y. Shape (3, 3)."""
    cx, sx, cy, sy = np.cos(about_x), np.sin(about_x), np.cos(about_y), np.sin(about_y)
    return np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])


def found_rotation(simulation: Simulation, curve: ObservedCurve, insertion: float, last: float | None) -> float:
    """Searches the rotation (rad) with which the device lies nearest to the curve after a short rest.

    Args:
        simulation: of the nominal device; it is moved.
        insertion: of the feeder, m.
        last: rotation of the last frame, near which it is searched; None: around the circle.
    """
    distances: dict[float, float] = {}

    def distance(rotation: float) -> float:
        if rotation not in distances:
            lay_along(simulation, curve, Feeder(insertion, rotation))
            for _ in range(_REST_STEPS):
                simulation.advance(0.0, 0.0)
            distances[rotation] = distance_to(simulation, curve) if simulation.valid else math.inf
        return distances[rotation]

    if last is not None:
        return min((last + step * NEAR for step in (0, -1, 1)), key=distance)
    step = 2 * math.pi / ANGLES
    best = min((float(angle) for angle in np.arange(ANGLES) * step - math.pi), key=distance)
    for _ in range(_HALVINGS):
        step /= 2
        best = min((best, best - step, best + step), key=distance)
    return best
