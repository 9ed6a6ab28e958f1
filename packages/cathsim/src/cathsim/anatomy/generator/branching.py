"""Growing one vessel: a centreline integrated from key directions, with windings and a radius profile."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.vessel_tree import Branch

STEP = 1e-3  # m between centreline points
_SUBSTEPS = 4

Array = NDArray[np.float64]


def smoothstep(t: Array) -> Array:
    """Smooth transition from 0 at t <= 0 to 1 at t >= 1 with two continuous derivatives, so without a kink."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * t * (t * (6 * t - 15) + 10)


def winding(arc: Array, amplitude: float, wavelength: float, rng: np.random.Generator) -> Array:
    """Displacement (n,) m of a tortuous vessel at arc lengths (n,) m: two waves of random phase.

    Args:
        amplitude, wavelength: m, of the longer wave.
    """
    phases = rng.uniform(0, 2 * math.pi, 2)
    longer = np.sin(2 * math.pi * arc / wavelength + phases[0])
    shorter = np.sin(2 * math.pi * 1.9 * arc / wavelength + phases[1])
    return amplitude * (longer + 0.3 * shorter)


def grow_branch(
    name: str,
    start: Array,
    directions: Sequence[tuple[float, Array]],
    radii: Sequence[tuple[float, float]],
    length: float,
    *,
    rng: np.random.Generator,
    parent: str = "",
    parent_arc: float = 0.0,
    winding_amplitude: float = 0.0,
    open_end: bool = True,
) -> Branch:
    """Grows a branch whose direction passes smoothly through key directions.

    Args:
        start: (3,) m, on the parent's centreline.
        directions: (arc m, unit vector (3,)) keys, arcs increasing from 0.
        radii: (arc m, radius m) keys, arcs increasing from 0.
        length: m of centreline from the start.
        parent, parent_arc: name of the vessel that it leaves, and m along that at which it starts.
        winding_amplitude: m of the windings, which fade out towards both ends.
        open_end: whether it ends in a flat opening.

    Returns:
        The branch, with points about 1 mm apart.
    """
    from scipy.interpolate import PchipInterpolator

    count = max(round(length / STEP), 4)
    arc = np.linspace(0, length, count * _SUBSTEPS + 1)
    keys = PchipInterpolator([a for a, _ in directions], np.array([d for _, d in directions]), axis=0)
    tangent = keys(np.clip(arc, 0, directions[-1][0]))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    steps = 0.5 * (tangent[1:] + tangent[:-1]) * np.diff(arc)[:, None]
    points = start + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    first = np.cross(tangent, [0.3, 1.0, 0.1])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(tangent, first)
    t = arc / length
    window = smoothstep((t - 0.2) / 0.4) * smoothstep((1 - t) / 0.4)
    for normal in (first, second):
        points = points + (window * winding(arc, winding_amplitude, 0.065, rng))[:, None] * normal
    points = points[::_SUBSTEPS]

    profile = PchipInterpolator([a for a, _ in radii], [r for _, r in radii])
    radius = profile(np.clip(arc[::_SUBSTEPS], 0, radii[-1][0]))
    return Branch(name, points, radius, parent, parent_arc, open_end)
