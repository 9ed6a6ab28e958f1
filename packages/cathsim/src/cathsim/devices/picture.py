"""Picture of devices: unloaded shapes with their true diameters on one scale, profiles of EI and GJ beside them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cathsim.devices.catheter import Catheter, unloaded_centreline
from cathsim.guidewire import Guidewire
from cathsim.viewing.figure import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MM, _NMM2 = 1e3, 1e6
_SHOWN = 0.17  # m from the tip that are drawn
_NAME = 15  # letters of a name in one line
_STEP = 2.5e-4  # m between points of a drawn centreline
_COLUMNS, _WIDTH, _HEIGHT = 8, 60.0, 204.0  # devices in a row; mm of the sheet for each
_SCALE = 50.0  # mm of the sheet in an inch of the picture
_PROFILE = 0.20  # m of the profiles
_BODY, _LUMEN, _MARKER, _WIRE = "#3b6ea5", "#dbe6f1", "#e0a020", "#222222"

Array = NDArray[np.float64]
Device = Guidewire | Catheter


def draw_devices(devices: Mapping[str, Device]) -> Figure:
    """Draws devices, by name, from the tip to 170 mm: shapes on one scale, profiles of EI and GJ below.

    Raises:
        ValueError: there is none.
    """
    if not devices:
        raise ValueError("a picture of devices needs at least one device")
    columns, rows = min(len(devices), _COLUMNS), -(-len(devices) // _COLUMNS)
    width, height = max(_COLUMNS * _WIDTH / _SCALE, 6.0), rows * _HEIGHT / _SCALE
    figure = new_figure(figsize=(width, height + 3.4), dpi=100, layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(height, 3.2))
    shapes, bending, torsion = (figure.add_subplot(at) for at in (grid[0, :], grid[1, 0], grid[1, 1]))
    for index, (name, device) in enumerate(devices.items()):
        _draw_shape(shapes, name, device, (index % _COLUMNS * _WIDTH, -(index // _COLUMNS) * _HEIGHT))
    shapes.set(aspect="equal", xlim=(-_WIDTH / 2, (columns - 0.5) * _WIDTH), xticks=[], yticks=[])
    shapes.set_ylim(_SHOWN * _MM + 2 - rows * _HEIGHT, _SHOWN * _MM + 4)
    shapes.set_frame_on(False)
    start = -_WIDTH / 2 + 2
    shapes.plot([start, start], [0, 50], color="0.3", linewidth=3, solid_capstyle="butt")
    shapes.text(start + 2, 25, "50 mm", rotation=90, va="center", fontsize=8)
    _draw_profiles(bending, devices, "EI")
    _draw_profiles(torsion, devices, "GJ")
    figure.legend(*bending.get_legend_handles_labels(), frameon=False, fontsize=7, ncols=6, loc="outside lower center")
    return figure


def drawn_shape(device: Device) -> Array:
    """The unloaded centreline in the plane of the picture, from the tip to 170 mm.

    Returns:
        (n, 2) m: to the side that a positive bend turns the tip to, and up. The proximal end comes up from the origin.
    """
    distance = np.linspace(0.0, _SHOWN, round(_SHOWN / _STEP) + 1)
    return unloaded_centreline(device.rest_curvature, distance)[:, [1, 2]] * (-1.0, 1.0)


def _draw_shape(axes: Axes, name: str, device: Device, at: tuple[float, float]) -> None:
    from matplotlib.patches import Polygon

    line = drawn_shape(device) * _MM
    line[:, 0] += at[0] - (line[:, 0].max() + line[:, 0].min()) / 2
    line[:, 1] += at[1]
    if isinstance(device, Guidewire):
        axes.add_patch(Polygon(_band(line, device.radius * _MM), color=_WIRE, linewidth=0))
        size = f"{device.diameter * _MM:.2f} mm"
    else:
        axes.add_patch(Polygon(_band(line, device.radius * _MM), color=_BODY, linewidth=0))
        axes.add_patch(Polygon(_band(line, device.inner_diameter / 2 * _MM), color=_LUMEN, linewidth=0))
        marker = line[: round(device.marker_length / _STEP) + 1]
        if len(marker) > 1:
            axes.add_patch(Polygon(_band(marker, device.radius * _MM), color=_MARKER, linewidth=0))
        size = f"{device.outer_diameter * _MM:.2f} / {device.inner_diameter * _MM:.2f} mm"
    if len(name) > _NAME:
        name = "_\n".join(name.rsplit("_", 1))
    axes.text(at[0], at[1] - 3.0, f"{name}\n{size}", ha="center", va="top", fontsize=8)


def _band(line: Array, radius: float) -> Array:
    """Outline of a band of constant width about a line in a plane."""
    along = np.gradient(line, axis=0)
    across = np.stack((-along[:, 1], along[:, 0]), axis=1) / np.linalg.norm(along, axis=1)[:, None]
    return np.concatenate((line + radius * across, (line - radius * across)[::-1]))


def _draw_profiles(axes: Axes, devices: Mapping[str, Device], which: str) -> None:
    from matplotlib import colormaps

    distance = np.linspace(0.0, _PROFILE, 201)
    wires = [name for name, device in devices.items() if isinstance(device, Guidewire)]
    colours = colormaps["tab20"].colors  # type: ignore[attr-defined]
    drawn: dict[tuple[bool, bytes], str] = {}
    for name, device in devices.items():
        profile = device.stiffness(distance) if which == "EI" else device.torsional_stiffness(distance)
        same = (name in wires, profile.tobytes())
        drawn[same] = f"{drawn[same]}, {name}" if same in drawn else name
    for index, ((wire, profile_bytes), names) in enumerate(drawn.items()):
        profile = np.frombuffer(profile_bytes) * _NMM2
        label = names if names.count(",") < 2 else f"{names.split(',')[0]} and {names.count(',')} others"
        colour = colours[index % len(colours)]
        axes.plot(distance * _MM, profile, label=label, color=colour, linestyle="-" if wire else "--")
    axes.set(yscale="log", xlabel="from the tip (mm)", ylabel=f"{which} (N mm²)")
    axes.grid(alpha=0.3, which="both")
