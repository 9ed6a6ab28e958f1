"""Picture of the blood's flow: the field from the front, the flow of the vessels over a beat, velocity profiles."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cathsim.blood.field import BloodField, blood_field
from cathsim.blood.flow import FLOWS, BloodFlow
from cathsim.blood.womersley import womersley_number
from cathsim.viewing.figure import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cathsim.anatomy import Phantom

_MM, _ML = 1e3, 1e6
_PIXEL = 1e-3  # m
_DEPTHS = 48  # points along a line of sight
_PROFILE_PHASES = (0.05, 0.12, 0.25, 0.36, 0.6)

Array = NDArray[np.float64]


def picture(phantom: Phantom, path: Path | None = None, *, flow: BloodFlow | None = None, time: float = 0.12) -> Figure:
    """Draws the flow: the field from the front, the flow of the open ends over a beat, profiles in the aorta.

    Args:
        path: PNG file to write, or None for the figure only.
        flow: by default the pulsatile one.
        time: of the field, s; the default is about peak systole.
    """
    field = blood_field(phantom, flow or FLOWS["pulsatile"])
    figure = new_figure(figsize=(11.0, 6.6), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.15))
    view, flows, profiles = (figure.add_subplot(at) for at in (grid[:, 0], grid[0, 1], grid[1, 1]))
    _draw_field(figure, view, field, time)
    _draw_flows(flows, field, time)
    _draw_profiles(profiles, field)
    if path is not None:
        figure.savefig(path)
    return figure


def frontal_field(field: BloodField, time: float) -> tuple[Array, Array, Array]:
    """The velocity seen from the front at a time (s): along each line of sight that of the fastest point.

    Returns:
        x (nx,) and z (nz,) m of the picture's points, velocity (nz, nx, 3) m/s, NaN where there is no lumen.
    """
    phantom = field.phantom
    low, high = phantom.bounds
    x, z = (np.arange(low[k] - 2e-3, high[k] + 2e-3, _PIXEL) for k in (0, 2))
    y = np.linspace(low[1], high[1], _DEPTHS)
    points = np.stack(np.meshgrid(z, x, y, indexing="ij"), axis=-1)[..., [1, 2, 0]]
    velocity = field.velocity(points, time)
    fastest = np.linalg.norm(velocity, axis=-1).argmax(axis=-1)
    seen = np.take_along_axis(velocity, fastest[..., None, None], axis=2)[:, :, 0]
    seen[phantom.grid.sample(points).max(axis=-1) <= 0] = np.nan
    return x, z, seen


def _draw_field(figure: Figure, axes: Axes, field: BloodField, time: float) -> None:
    from matplotlib.colors import Normalize

    x, z, velocity = frontal_field(field, time)
    speed = np.linalg.norm(velocity, axis=-1)
    top = float(np.nanmax(speed)) or 1.0
    across, up = np.meshgrid(x * _MM, z * _MM)
    grid = field.phantom.grid
    lattice = [(grid.origin[k] + grid.spacing * np.arange(grid.shape[k])) * _MM for k in (0, 2)]
    silhouette = grid.silhouette(1).T
    axes.contourf(*lattice, silhouette, levels=[0.0, 1.0], colors=["#ece7f2"])
    axes.contour(*lattice, silhouette, levels=[0.0], colors="0.45", linewidths=0.8)
    u, w = (np.nan_to_num(velocity[..., k]) for k in (0, 2))
    stream = axes.streamplot(
        *(across, up, u, w),
        color=np.nan_to_num(speed) * 100,
        cmap="turbo",
        density=3.0,
        linewidth=0.9,
        arrowsize=0.8,
        norm=Normalize(0.0, 100 * top),
    )
    figure.colorbar(stream.lines, ax=axes, label="largest speed along the line of sight (cm/s)", shrink=0.8)
    axes.set(aspect="equal", xlabel="x, patient's left (mm)", ylabel="z, superior (mm)")
    axes.set_title(f"{field.phantom.name}, {field.flow.waveform}, {time:.2f} s after the valve opens")


def _draw_flows(axes: Axes, field: BloodField, time: float) -> None:
    beat = 1.0 / field.flow.heart_rate
    times = np.linspace(0.0, beat, 200)
    inlet = field.flow_rate(times) * _ML
    axes.plot(times, inlet, color="black", label="aortic root")
    for name, share in field.shares.items():
        end = "descending aorta" if name == field.phantom.tree.root.name else name
        axes.plot(times, share * inlet, linewidth=1.2, label=f"{end} {100 * share:.0f} %")
    axes.axvline(time % beat, color="0.6", linestyle=":")
    output = field.cardiac_output * 6e4
    axes.set(xlabel="time (s)", ylabel="flow (mL/s)", title=f"flow of the open ends, mean {output:.1f} L/min")
    axes.legend(frameon=False, fontsize=8, ncols=2)
    axes.grid(alpha=0.3)


def _draw_profiles(axes: Axes, field: BloodField) -> None:
    """Across the descending aorta at several moments."""
    root = field.phantom.tree.root
    arc = 0.25 * root.length
    centre, tangent, radius = root.point_at(arc), root.tangent_at(arc), float(root.radius_at(arc))
    side = np.cross(tangent, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    at = np.linspace(-radius, radius, 161)
    for phase in _PROFILE_PHASES:
        velocity = field.velocity(centre + at[:, None] * side, phase / field.flow.heart_rate)
        axes.plot(at * _MM, -100 * (velocity @ tangent), linewidth=1.2, label=f"phase {phase:.2f}")
    physics = {"density": field.flow.density, "viscosity": field.flow.viscosity}
    alpha = float(womersley_number(radius, field.flow.heart_rate, **physics))
    title = f"across the descending aorta, Womersley number {alpha:.0f}"
    axes.set(xlabel="from the axis (mm)", ylabel="velocity (cm/s)", title=title)
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)
