"""The observed curve of a device in a vessel: checked, smoothed, from the entry to the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy import Phantom
from cathsim.anatomy.centreline import arc_length, resampled, smoothed
from cathsim.devices.arena import PROTRUSION
from cathsim.simulation import Simulation
from cathsim.statics.uncertainty import smooth_noise

STEP = 1e-3  # m between the points of a curve
SMOOTHING = 1.5e-3  # m, deviation of the Gaussian along the curve: more would cut the bent tip short
MOST_GAP = 0.010  # m from the entry at which a curve may begin
MOST_OUTSIDE = 5e-3  # m beyond the wall: errors of reconstruction and registration
_SHORTEST = 1e-6  # m
_LOOK_AHEAD = 0.02  # m from the entry within which a curve shows on which side of it the lumen lies
_INSERTION_MISFIT = (0.010, 0.05)  # m, and share of the length, by which insertion and curve may disagree

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ObservedCurve:
    """A device's axis from the entry to the tip."""

    points: Array  # smoothed, at even steps, m, world frame. Shape (n, 3).
    length: float  # arc length from the entry to the tip, m

    @property
    def insertion(self) -> float:
        """The insertion (m) that a wire of this length has."""
        return max(self.length - PROTRUSION, 0.0)

    def at(self, from_tip: Array, length: float | None = None) -> Array:
        """Points (k, 3) m at distances (k,) m from the tip, none further than the entry.

        Args:
            length: of the device beyond the entry, m, to which the curve is stretched; None: as it is.
        """
        arcs = arc_length(self.points)
        arcs *= (self.length if length is None else length) / arcs[-1]
        at = arcs[-1] - from_tip
        return np.stack([np.interp(at, arcs, self.points[:, axis]) for axis in range(3)], axis=1)


def inserted_curve(simulation: Simulation) -> Array:
    """The part of a simulated device, or of the pair's further one, beyond the entry, as `contact_forces` takes it.

    Returns:
        Points (n, 3) m, world frame, from the entry to the tip.
    """
    return inserted_part(simulation.inserted_points(), float(simulation.data.qpos[0]))


def inserted_part(points: Array, insertion: float) -> Array:
    """The part of a device beyond the entry.

    Args:
        points: from the tip to the proximal end, as `Simulation.wire_points` gives them, m. Shape (k, 3).
        insertion: of the feeder, m.

    Returns:
        Points (n, 3) m from the entry to the tip.
    """
    points = points[::-1]
    arcs = arc_length(points)
    start = arcs[-1] - (insertion + PROTRUSION)
    at = np.concatenate(([start], arcs[arcs > start + 1e-6]))
    return np.stack([np.interp(at, arcs, points[:, axis]) for axis in range(3)], axis=1)


def curve_from_entry(curve: ArrayLike, phantom: Phantom, entry: str = "descending") -> Array:
    """A reconstructed curve as `contact_forces` takes it: from the entry to the tip, what lies in the sheath cut off.

    Args:
        curve: points (n, 3) m, world frame, in either order; `guide3d` gives mm, tip first.
        entry: name of the phantom's entry.

    Returns:
        Points (m, 3) m.

    Raises:
        ValueError: another shape, numbers that are not finite, an unknown entry, or a curve that does not reach it.
    """
    points = _checked_points(curve)
    site = phantom.entry(entry)
    at, nearest = _nearest_on(points, site.position)
    gap = float(np.linalg.norm(nearest - site.position))
    if gap > MOST_GAP:
        raise ValueError(
            f"a curve passes within {1e3 * MOST_GAP:g} mm of the entry '{entry}', this one {1e3 * gap:.1f} mm from it: "
            "give the whole wire up to the sheath, in m, in the phantom's frame"
        )
    sides = [np.vstack((nearest, points[at + 1 :])), np.vstack((nearest, points[at::-1]))]
    into = [float(((side - site.position) @ site.direction)[arc_length(side) <= _LOOK_AHEAD].mean()) for side in sides]
    return sides[int(np.argmax(into))]


def noisy_curve(curve: Array, deviation: float, generator: np.random.Generator, *, width: float = 0.010) -> Array:
    """A curve (n, 3) m with noise of a deviation (m) along each axis that is smooth over a width (m)."""
    points = resampled(curve, STEP)
    return np.asarray(points + deviation * smooth_noise(len(points), STEP, width, generator))


def observed_curve(curve: ArrayLike, phantom: Phantom, entry: str, max_insertion: float) -> ObservedCurve:
    """Checks a curve, ties it to the entry and smooths it.

    Args:
        curve: points (n, 3) m, world frame, from the entry to the tip.
        max_insertion: of the device, m.

    Raises:
        ValueError: another shape, numbers that are not finite, points in one place or outside the lumen, a first point
            far from the entry, or a length that the device does not have.
    """
    points = _checked_points(curve)
    site = phantom.entry(entry)
    gap, other = (float(np.linalg.norm(points[end] - site.position)) for end in (0, -1))
    if gap > MOST_GAP:
        hint = "reverse it, from the entry to the tip" if other <= MOST_GAP else "give it in m, in the phantom's frame"
        raise ValueError(
            f"a curve begins within {1e3 * MOST_GAP:g} mm of the entry '{entry}', this one {1e3 * gap:.1f} mm from it: "
            f"{hint}"
        )
    depth = phantom.grid.sample(points)
    deepest = int(np.argmin(depth))
    if depth[deepest] < -MOST_OUTSIDE:
        raise ValueError(
            f"a curve lies in the lumen, point {deepest} of this one is {-1e3 * depth[deepest]:.1f} mm or more outside "
            "of it: register it to the phantom first"
        )
    tied = _tied(points, site.position, site.direction)
    if min(np.ptp(points, axis=0).max(), np.ptp(tied, axis=0).max()) < _SHORTEST:
        raise ValueError(
            f"a curve runs from the entry to the tip, the {len(points)} points of this one lie in one place: give all "
            "of it"
        )
    points = smoothed(resampled(tied, STEP), SMOOTHING)
    length = float(arc_length(points)[-1])
    if length > max_insertion + PROTRUSION + MOST_GAP:
        raise ValueError(
            f"the device reaches {max_insertion + PROTRUSION:.3f} m beyond the entry, the curve is {length:.3f} m "
            "long: give a longer device, e.g. Guidewire().scaled(0.5)"
        )
    return ObservedCurve(points, min(length, max_insertion + PROTRUSION))


def checked_insertion(insertion: float, curve: ObservedCurve, max_insertion: float) -> float:
    """Checks an insertion (m) against the device and the curve.

    Raises:
        ValueError: it is no finite number, beyond the device, or far from the curve's length.
    """
    if not np.isfinite(insertion) or not 0 <= insertion <= max_insertion:
        raise ValueError(f"insertion must lie in 0 to {max_insertion:.3f} m, got {insertion}")
    misfit = abs(insertion - curve.insertion)
    if misfit > _INSERTION_MISFIT[0] + _INSERTION_MISFIT[1] * curve.length:
        raise ValueError(
            f"an insertion of {insertion:.3f} m does not fit a curve of {curve.length:.3f} m: expected about "
            f"{curve.insertion:.3f} m, or None where the feeder's position is not known"
        )
    return float(insertion)


def _checked_points(curve: ArrayLike) -> Array:
    """Finite points of shape (n, 3), two at least."""
    try:
        points = np.array(curve, np.float64)
    except (TypeError, ValueError):
        raise ValueError("a curve must be numbers of shape (n, 3), in m, from the entry to the tip") from None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
        raise ValueError(f"a curve must have shape (n, 3) with 2 points at least, got {points.shape}")
    if not np.isfinite(points).all():
        first = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise ValueError(f"a curve must be finite, its point {first} is {points[first]}: leave such points out")
    return points


def _nearest_on(points: Array, place: Array) -> tuple[int, Array]:
    """The segment of a polyline nearest to a place, and the point on it."""
    starts, steps = points[:-1], np.diff(points, axis=0)
    squared = np.maximum((steps**2).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(((place - starts) * steps).sum(axis=1) / squared, 0.0, 1.0)
    feet = starts + share[:, None] * steps
    at = int(np.argmin(np.linalg.norm(feet - place, axis=1)))
    return at, feet[at]


def _tied(points: Array, entry: Array, direction: Array) -> Array:
    """The curve with what lies in the sheath cut off, and tied to the entry where it begins beyond it."""
    along = (points - entry) @ direction
    beyond = int(np.argmax(along > 0)) if (along > 0).any() else 0
    if beyond > 0:  # the segment in which the curve leaves the sheath
        share = along[beyond - 1] / (along[beyond - 1] - along[beyond])
        start = points[beyond - 1] + share * (points[beyond] - points[beyond - 1])
        return np.vstack((start, points[beyond:]))
    return np.vstack((points[0] - along[0] * direction, points)) if along[0] > STEP else points
