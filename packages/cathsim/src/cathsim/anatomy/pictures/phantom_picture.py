"""Picture of a phantom: the lumen's surface, shaded, from several sides, with centrelines, entry and targets."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.phantom import Phantom
from cathsim.viewing.figure import new_figure, plain_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The viewer's place as a turn about the superior axis from straight in front, towards the patient's left, degrees.
VIEWS = {"front": 0.0, "left anterior oblique": 45.0, "left": 90.0}
_VESSEL = np.array([0.80, 0.33, 0.29])
_STEPS = 90

Array = NDArray[np.float64]


def draw_phantom(phantom: Phantom, path: Path | None = None, *, pixel: float = 5e-4) -> Figure:
    """Draws a phantom from the front, the left anterior oblique and the left.

    Args:
        path: PNG file to write, or None for the figure only.
        pixel: m per picture element.
    """
    low, high = phantom.bounds
    centre = (low + high) / 2
    half_height = (high[2] - low[2]) / 2 + 6e-3
    half_width = float(np.linalg.norm((high - low)[:2])) / 2 + 3e-3
    figure = new_figure(
        figsize=(12.6, 3.75 * half_height / half_width + 1.1), dpi=110, facecolor="white", layout="constrained"
    )
    panels = figure.subplots(1, len(VIEWS), sharey=True)
    for panel, (label, turn) in zip(panels, VIEWS.items(), strict=True):
        right, toward = camera(turn)
        image = _render(phantom.grid, centre, right, toward, half_width, half_height, pixel)
        extent = np.array([-half_width, half_width, -half_height, half_height]) * 1e3
        panel.imshow(image, extent=tuple(extent), origin="lower", interpolation="bilinear")
        for branch in phantom.tree:
            flat = picture_point(branch.points, centre, right)
            panel.plot(flat[:, 0], flat[:, 1], color="white", linewidth=0.9, alpha=0.7)
        for target in phantom.targets.values():
            x, y = picture_point(target.position, centre, right)
            panel.plot(x, y, "o", color="#ffd23f", markeredgecolor="black", markersize=6)
            panel.annotate(
                plain_text(target.name),
                (x, y),
                (7, 3),
                textcoords="offset points",
                fontsize=8.5,
                weight="bold",
                color="#1c2a3a",
            )
        for entry in phantom.entries.values():
            x, y = picture_point(entry.position, centre, right)
            dx, dy = picture_point(entry.position + 0.014 * entry.direction, centre, right) - (x, y)
            panel.annotate(
                "", (x + dx, y + dy), (x, y), arrowprops={"arrowstyle": "-|>", "color": "#1b6ca8", "linewidth": 1.8}
            )
        panel.set_title(label, fontsize=11)
        panel.set_xlabel("mm")
        panel.set_aspect("equal")
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[0].set_ylabel("mm, towards the head")
    size = (high - low) * 1e3
    extents = f"{size[0]:.0f} x {size[1]:.0f} x {size[2]:.0f} mm (left-right, front-back, height)"
    figure.suptitle(f"{plain_text(phantom.name.replace('_', ' '))}: {extents}", fontsize=12)
    if path is not None:
        figure.savefig(path)
    return figure


def render_lumen(phantom: Phantom, turn: float, half_width: float, half_height: float, pixel: float) -> Array:
    """The shaded lumen from one side, bottom row first, (rows, columns, 3) in 0 to 1.

    Args:
        turn: of the view about the superior axis from straight in front, towards the patient's left, degrees.
        half_width, half_height: of the picture about the lumen's middle, m.
        pixel: m per picture element.
    """
    right, toward = camera(turn)
    return _render(phantom.grid, phantom.bounds.mean(axis=0), right, toward, half_width, half_height, pixel)


def camera(turn: float) -> tuple[Array, Array]:
    """Unit vectors to the picture's right and towards the viewer."""
    angle = math.radians(turn)
    return (np.array([math.cos(angle), math.sin(angle), 0.0]), np.array([math.sin(angle), -math.cos(angle), 0.0]))


def picture_point(points: Array, centre: Array, right: Array) -> Array:
    """Picture coordinates (..., 2) mm."""
    offset = np.asarray(points) - centre
    return np.stack([offset @ right, offset[..., 2]], axis=-1) * 1e3


def _render(
    grid: SignedDistanceGrid,
    centre: Array,
    right: Array,
    toward: Array,
    half_width: float,
    half_height: float,
    pixel: float,
) -> Array:
    """Shaded parallel projection (rows, columns, 3) by sphere tracing through the distance grid."""
    columns = np.arange(-half_width, half_width, pixel)
    rows = np.arange(-half_height, half_height, pixel)
    across, upward = np.meshgrid(columns, rows)
    depth = half_width
    position = centre + across[..., None] * right + upward[..., None] * np.array([0, 0, 1.0]) + depth * toward
    position = position.reshape(-1, 3)
    active = np.arange(len(position))
    hit = np.zeros(len(position), dtype=bool)
    for _ in range(_STEPS):
        value = grid.sample(position[active])
        struck = value > -5e-5
        hit[active[struck]] = True
        active, value = active[~struck], value[~struck]
        position[active] -= np.maximum(-0.9 * value, 1e-4)[:, None] * toward
        active = active[(position[active] - centre) @ toward > -depth]
        if not len(active):
            break
    image = np.ones((len(position), 3))
    if hit.any():
        normal = -grid.gradient(position[hit])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        light = 0.45 * right * -1 + 0.75 * toward + np.array([0, 0, 0.55])
        light /= np.linalg.norm(light)
        halfway = light + toward
        halfway /= np.linalg.norm(halfway)
        diffuse = np.clip(normal @ light, 0, 1)
        facing = np.clip(normal @ toward, 0, 1)
        shine = np.clip(normal @ halfway, 0, 1) ** 40
        far = ((position[hit] - centre) @ toward) / depth
        tone = (0.28 + 0.62 * diffuse + 0.15 * facing) * (0.92 + 0.14 * np.clip(far, -1, 1))
        image[hit] = np.clip(_VESSEL * tone[:, None] + 0.22 * shine[:, None], 0, 1)
    return image.reshape(*across.shape, 3)
