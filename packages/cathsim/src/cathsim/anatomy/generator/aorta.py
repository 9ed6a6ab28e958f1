"""The aorta before its branches: centreline, radius and the direction of its outer curvature.

The arch's own frame has u from the ascending to the descending limb, v out of the plane, w up. Its centreline is the
integral of a direction that turns from "up" in the descending limb to "down" in the ascending one; the turn's density
along the arc is a beta distribution, so curvature is smooth and the bend may lie nearer to one limb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.generator.arch_parameters import Aneurysm, ArchParameters
from cathsim.anatomy.generator.branching import STEP, smoothstep, winding

STRAIGHT_ENTRY = 0.022  # m of straight descending aorta at its open end
TAPER_LENGTH = 0.2  # m over which the aorta narrows from root to descending diameter

Array = NDArray[np.float64]
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Aorta:
    """A bare aorta, sampled at steps of STEP from the descending end to the root."""

    points: Array  # (n, 3) m, centreline
    tangents: Array  # (n, 3) unit vectors along it
    outward: Array  # (n, 3) unit vectors to the outer curvature
    radius: Array  # (n,) m

    @property
    def outer_wall(self) -> Array:
        """Line (n, 3) m along the wall's outer curvature."""
        return self.points + self.outward * self.radius[:, None]

    @property
    def top(self) -> float:
        """Height of the highest point of its wall, m."""
        return float(np.max(self.points[:, 2] + self.radius * np.sqrt(1 - self.tangents[:, 2] ** 2)))

    def arc_of(self, index: int) -> float:
        """Arc length (m) from the descending end to a centreline point."""
        return float(np.linalg.norm(np.diff(self.points[: index + 1], axis=0), axis=1).sum())


def shape_aorta(parameters: ArchParameters, rng: np.random.Generator) -> Aorta:
    """Shapes the aorta from the descending end over the arch to the root, its apex at about height zero.

    Raises:
        ValueError: the measures do not fit together; the message says why.
    """
    plane, straight, bent = _in_plane(parameters)
    plane, sideways = _wound(parameters, plane, straight, bent, rng)
    points, outward_axis = _in_space(parameters, plane, sideways)
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    outward = np.cross(tangents, outward_axis)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    if np.dot(outward[np.argmax(points[:, 2])], _UP) < 0:
        outward = -outward
    arc = np.arange(len(points), dtype=np.float64) * STEP
    blend = smoothstep((arc - (arc[-1] - TAPER_LENGTH)) / TAPER_LENGTH)
    radius = 0.5 * (
        parameters.descending_diameter + (parameters.root_diameter - parameters.descending_diameter) * blend
    )
    curvature = np.linalg.norm(np.gradient(tangents, axis=0), axis=1) / STEP
    tightest = float(np.max((curvature * radius)[5:-5]))
    if tightest > 0.8:
        raise ValueError(
            f"the aorta bends too tightly for its radius (curvature times radius {tightest:.2f}, at most 0.8): "
            "raise arch_width, or lower root_diameter, arch_skew or tortuosity."
        )
    return Aorta(points, tangents, outward, radius)


def _in_plane(parameters: ArchParameters) -> tuple[Array, float, float]:
    """The aorta without winding in its own plane, (n, 2) m across and up, and lengths of its descending part and arch.

    Raises:
        ValueError: the arch does not fit between its ends.
    """
    from scipy.optimize import brentq

    def width_error(length: float) -> float:
        return -float(_arch(parameters, length)[0][:, 0].min()) - parameters.arch_width

    length = float(brentq(width_error, 0.03, 0.6, xtol=1e-6))
    curve, angle = _arch(parameters, length)
    curve = curve - np.array([-parameters.arch_width / 2, curve[:, 1].max()])
    straight = float(parameters.descending_height + curve[0, 1])
    tail = (parameters.ascending_height + curve[-1, 1]) / -math.cos(angle[-1])
    if straight < STRAIGHT_ENTRY + 0.02 or tail < 0.01:
        raise ValueError(
            "the arch does not fit between its ends: raise descending_height or ascending_height, or lower arch_width."
        )
    below = curve[0] - np.array([0, 1]) * np.arange(straight, 0, -STEP)[:, None]
    beyond = np.array([-math.sin(angle[-1]), math.cos(angle[-1])])
    after = curve[-1] + beyond * np.arange(STEP, tail + STEP, STEP)[:, None]
    return _resample(np.concatenate([below, curve, after])), straight, length


def _arch(parameters: ArchParameters, length: float) -> tuple[Array, Array]:
    """The arch alone, (n, 2) m from its beginning, and the turned angle (n,), for an arc of this length."""
    from scipy.special import betainc

    t = np.linspace(0, 1, 400)
    skew, turn = parameters.arch_skew, math.pi + parameters.ascending_lean
    angle = turn * betainc(1.9 * math.exp(-skew), 1.9 * math.exp(skew), t)
    velocity = np.stack([-np.sin(angle), np.cos(angle)], axis=1) * length
    middle = 0.5 * (velocity[1:] + velocity[:-1]) * (t[1] - t[0])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(middle, axis=0)]), angle


def _wound(
    parameters: ArchParameters, plane: Array, straight: float, bent: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """The aorta in its plane with its winding, (n, 2) m, and how far it lies out of that, (n,) m.

    Args:
        straight, bent: m, lengths of the descending part and of the arch.
    """
    arc = np.arange(len(plane), dtype=np.float64) * STEP
    window = smoothstep((arc - STRAIGHT_ENTRY) / 0.07) * smoothstep((arc[-1] - arc) / 0.04)
    bow = np.sin(math.pi * np.clip((arc - straight) / bent, 0, 1)) ** 2
    sideways = parameters.out_of_plane * bow + window * winding(arc, parameters.tortuosity, 0.11, rng)
    inplane = window * winding(arc, parameters.tortuosity, 0.12, rng)
    tangent = np.gradient(plane, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    return plane + inplane[:, None] * normal, sideways


def _in_space(parameters: ArchParameters, plane: Array, sideways: Array) -> tuple[Array, Array]:
    """The aorta in space, (n, 3) m at steps of STEP, and the (3,) axis that the arch bends about."""
    yaw, tilt = parameters.arch_yaw, parameters.arch_tilt
    u = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    v = np.cross(_UP, u)
    # Only what lies above the straight entry leans, so that the wire still enters along the vertical.
    lean = math.tan(tilt) * _smooth_ramp(plane[:, 1] - plane[0, 1] - STRAIGHT_ENTRY, 0.03)
    points = _resample(plane[:, :1] * u + (sideways + lean)[:, None] * v + plane[:, 1:] * _UP)
    return points, np.cross(_UP * math.cos(tilt) + v * math.sin(tilt), u)


def fusiform_widening(aneurysm: Aneurysm, points: Array, lsa_arc: float) -> Array:
    """Radius (n,) m that a spindle-shaped aneurysm adds.

    Args:
        points: (n, 3) m, aortic centreline at steps of STEP.
        lsa_arc: m along it, where the LSA leaves.
    """
    t = (np.arange(len(points)) * STEP - (lsa_arc - aneurysm.distance)) / (aneurysm.length / 2)
    return aneurysm.bulge * np.where(np.abs(t) < 1, np.cos(0.5 * math.pi * np.clip(t, -1, 1)) ** 2, 0.0)


def _smooth_ramp(x: Array, width: float) -> Array:
    """Zero below 0, then x with a smooth start over `width`."""
    positive = np.maximum(x, 0.0)
    return positive * smoothstep(positive / width)


def _resample(points: Array) -> Array:
    """The same curve at equal steps of STEP (the last one a little off, so that the end stays)."""
    from scipy.interpolate import CubicSpline

    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9])
    points = points[keep]
    arc = arc_length(points)
    count = round(arc[-1] / STEP) + 1
    return CubicSpline(arc, points)(np.linspace(0, arc[-1], count))
