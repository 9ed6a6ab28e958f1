"""Synthetic two-view scenes with ground truth: a rig like the group's, wires in space, and annotations of them.

World millimetres, x along the long axis, y down, z away from the cameras. Wires run tip first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import Array, resample

FOCAL_PX = (5150.0, 4450.0)
SIZE_PX = 1024
SCALE_MM = 0.19  # a pixel's size where both axes meet
BETWEEN_AXES_DEG = 91.0
SPACING_MM = 0.25  # of the true curve's points
SAG_PX = 2.0  # how far a person lets a chord leave the wire before clicking in between
ENTRY_DEG = -12.0  # rise of a shaft against the epilines where it comes in: as steep as in the real pairs
KINDS = ("arch", "hook", "loop", "shaft")


@dataclass(frozen=True, eq=False)
class SyntheticScene:
    """A wire in space and what a person annotates of it.

    cameras: A and B
    curve_mm: (n, 3) the true wire, tip first, as far as both views see it
    points: per view (n, 2) px, the annotation, tip first, up to where the wire leaves the image
    """

    kind: str
    cameras: tuple[Camera, Camera]
    curve_mm: Array
    points: tuple[Array, Array]


def rig(rng: np.random.Generator | None = None) -> tuple[Camera, Camera]:
    """Returns cameras in the group's geometry: axes 91 degrees apart, sources 1.3 m apart, 0.19 mm/px where they meet.

    Args:
        rng: turns each camera about its axis and moves its principal point a little, as a real rig has it; None
            keeps both upright and centred.

    Returns:
        Cameras A and B; the baseline runs along the images' x, and so nearly do the epilines.
    """
    cameras = []
    for name, focal, side in (("A", FOCAL_PX[0], 1.0), ("B", FOCAL_PX[1], -1.0)):
        roll, tilt, shift = (0.0, 0.0, np.zeros(2)) if rng is None else (*rng.normal(0, 2.5, 2), rng.normal(0, 40, 2))
        half = side * BETWEEN_AXES_DEG / 2
        R = (Rotation.from_euler("y", half, degrees=True) * Rotation.from_euler("xz", [tilt, roll], degrees=True)).inv()
        middle = (SIZE_PX - 1) / 2
        K = np.array([[focal, 0.0, middle + shift[0]], [0.0, focal, middle + shift[1]], [0.0, 0.0, 1.0]])
        # the world's origin stays in the middle of the image
        origin = np.linalg.solve(K, [middle, middle, 1.0]) * focal * SCALE_MM
        cameras.append(Camera(K, R.as_matrix(), origin, SIZE_PX, SIZE_PX, name))
    return cameras[0], cameras[1]


def wire(kind: str, rng: np.random.Generator, length_mm: float = 360.0) -> Array:
    """Draws a wire in space: smooth random curvature about the shape that its kind names.

    Args:
        kind: "arch" (a turn by 60 to 150 degrees), "hook" (an arch with a bent tip of 4 to 8 mm radius), "loop" (a
            full turn of 10 to 25 mm radius that moves on sideways) or "shaft" (straight but for a gentle end).

    Returns:
        (n, 3) points every 0.25 mm, tip first, the tip at the origin; the shaft comes from -x.

    Raises:
        ValueError: an unknown kind.
    """
    if kind not in KINDS:
        raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    count = round(length_mm / SPACING_MM) + 1
    s = SPACING_MM * np.arange(count)[::-1]  # from the proximal end to the tip, s counts from the tip
    bend = np.stack([gaussian_filter1d(rng.normal(size=count), 12.0 / SPACING_MM) for _ in range(2)])
    bend *= (0.002 if kind == "shaft" else 0.006) / bend.std()

    def turn(degrees: float, middle_mm: float, width_mm: float, direction: float) -> None:
        shape = np.exp(-0.5 * ((s - middle_mm) / width_mm) ** 2)
        shape *= np.radians(degrees) / (shape.sum() * SPACING_MM)
        bend[0] += shape * np.cos(direction)
        bend[1] += shape * np.sin(direction)

    plane = rng.uniform(0, 2 * np.pi)
    if kind == "shaft":
        turn(rng.uniform(10, 50), rng.uniform(20, 60), rng.uniform(8, 20), plane)
    else:
        turn(rng.uniform(60, 150), rng.uniform(40, 90), rng.uniform(15, 30), plane)
    if kind == "hook":
        radius = rng.uniform(4.0, 8.0)
        degrees = rng.uniform(45, 140)
        width = radius * np.radians(degrees) / np.sqrt(2 * np.pi)
        turn(degrees, 2.5 * width, width, rng.uniform(0, 2 * np.pi))
    direction = rng.normal([1.0, np.tan(np.radians(ENTRY_DEG)), 0.0], [0.1, 0.1, 0.25])
    start = Rotation.align_vectors([direction], [[1.0, 0.0, 0.0]])[0]
    if kind == "loop":
        radius, middle = rng.uniform(10, 25), rng.uniform(40, 90)
        span = 2 * np.pi * radius * rng.uniform(0.9, 1.15)
        inside = 1 / (1 + np.exp((np.abs(s - middle - span / 2) - span / 2) / 3.0))
        bend[0] += inside / radius * np.cos(plane)
        bend[1] += inside / radius * np.sin(plane)
        twist = inside * rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.35) / radius
    else:
        twist = np.zeros(count)
    rotations = _integrated(bend, twist, start)
    steps = rotations[:-1, :, 0] * SPACING_MM
    curve = np.concatenate([[np.zeros(3)], np.cumsum(steps, axis=0)])[::-1]
    return np.ascontiguousarray(curve - curve[0])


def _integrated(bend: Array, twist: Array, start: Rotation) -> Array:
    """Integrates curvature in a moving frame whose first axis is the tangent; (n, 3, 3)."""
    steps = Rotation.from_rotvec(np.stack([twist, -bend[1], bend[0]], axis=1) * SPACING_MM).as_matrix()
    frames = np.empty_like(steps)
    frame = start.as_matrix()
    for i, step in enumerate(steps):
        frames[i] = frame
        frame = frame @ step
    return frames


def seen(camera: Camera, curve_mm: Array) -> Array:
    """Returns the (n, 2) px of a curve from its tip to where it first leaves the image, or an empty array."""
    pixels = camera.project(curve_mm)
    inside = camera.contains(pixels)
    return np.asarray(pixels if inside.all() else pixels[: int(np.argmin(inside))])


def clicked(points: Array, rng: np.random.Generator, noise_px: float) -> Array:
    """Annotates a curve as a person does: both ends and a point every 15 to 30 px, closer where it bends or folds.

    Args:
        points: (n, 2) px, the curve.
        noise_px: standard deviation of a click in x and in y.

    Returns:
        (m, 2) px.
    """
    dense = resample(points, spacing=1.0)
    last = len(dense) - 1
    positions = [0]
    while True:
        step = rng.uniform(15.0, 30.0)
        while step > 4.0 and _sag(dense[positions[-1] : positions[-1] + round(step) + 1]) > SAG_PX:
            step *= 0.8
        if positions[-1] + 1.5 * step >= last:
            break
        positions.append(positions[-1] + round(step))
    positions.append(last)
    exact = dense[positions]
    return np.asarray(exact + rng.normal(0.0, noise_px, exact.shape))


def _sag(points: Array) -> float:
    chord = points[-1] - points[0]
    offsets = points - points[0]
    share = np.clip(offsets @ chord / max(chord @ chord, 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(offsets - share[:, None] * chord, axis=1).max())


def scene(index: int, seed: int = 0, noise_px: float | None = None) -> SyntheticScene:
    """Draws a scene: a rig and a wire whose tip lies in both images, and of which both see at least 60 mm.

    Args:
        index: among the scenes of a seed; kinds take turns.
        seed: of all randomness; the wires do not depend on the noise.
        noise_px: None annotates exactly and densely (every px); a number clicks every 15 to 30 px with that noise.
    """
    rng = np.random.default_rng([seed, index])
    clicks = np.random.default_rng([seed, index, 1])
    kind = KINDS[index % len(KINDS)]
    while True:
        cameras = rig(rng)
        curve = wire(kind, rng) + np.append(rng.uniform([5.0, -40.0], [50.0, 40.0]), rng.uniform(-25.0, 25.0))
        views = [seen(camera, curve) for camera in cameras]
        if min(len(view) for view in views) * SPACING_MM >= 60.0:
            break
    curve = curve[: min(len(view) for view in views)]
    if noise_px is None:
        points = [resample(view, spacing=1.0) for view in views]
    else:
        points = [clicked(view, clicks, noise_px) for view in views]
    return SyntheticScene(kind, cameras, curve, (points[0], points[1]))


def scenes(count: int, seed: int = 0, noise_px: float | None = None) -> Iterator[SyntheticScene]:
    """The first scenes of a seed, as `scene` draws them."""
    return (scene(index, seed, noise_px) for index in range(count))
