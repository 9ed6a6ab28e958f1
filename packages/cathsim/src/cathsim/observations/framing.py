"""What an X-ray view of an observation holds: all of a phantom, or a field of fixed size about the aortic arch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.fluoroscopy import WATER_BATH, Box, Projector
from cathsim.fluoroscopy.projector import VIEWS

ABOVE_ARCH = 4 / 9  # of a field's side: what it holds above the highest point of the aorta's axis
_BATH_HALF_HEIGHT = min(box.half_sides[2] for box in WATER_BATH[:2] if isinstance(box, Box))  # m: of the water
_NEARER = 1.15  # a field is as much wider on the side of the bath that is away from the source


def require_field(field: float | None) -> None:
    """Refuses a field that is no positive length with a ValueError; None is all of a phantom."""
    if field is not None and not (field > 0 and np.isfinite(field)):
        raise ValueError(f"the field of view must be a positive length, got {field!r} m")


def arch_centre(phantom: Phantom, field: float) -> NDArray[np.float64]:
    """The isocentre for a field about the arch, m. Shape (3,).

    The highest point of the aorta's axis lies `ABOVE_ARCH` of the field below its upper border; from side to side and
    from front to back the isocentre is in the middle of what the field holds of the axis.

    Args:
        field: side of the square that the images show in the plane of the isocentre, m.
    """
    axis = np.asarray(phantom.tree.root.points)
    top = axis[:, 2].max()
    held = axis[axis[:, 2] > top - (1 - ABOVE_ARCH) * field]
    middle = (held.min(axis=0) + held.max(axis=0)) / 2
    return np.array([middle[0], middle[1], top + (ABOVE_ARCH - 0.5) * field])


def raised_bath(phantom: Phantom, field: float) -> float:
    """How far the water bath has to stand above the middle of a phantom to fill a field about its arch, m.

    0 in an arch alone, about which it stands anyhow. In a whole aorta the arch lies far from the middle.
    """
    margin = max(_BATH_HALF_HEIGHT - _NEARER * field / 2, 0.0)
    away = float(arch_centre(phantom, field)[2] - phantom.bounds[:, 2].mean())
    return away - min(max(away, -margin), margin)


def framed(phantom: Phantom, view: str, size: int, field: float | None = None) -> Projector:
    """The camera of a named view.

    Args:
        view: one of `cathsim.fluoroscopy.projector.VIEWS`.
        size: side of the images, px.
        field: side of the square that they show in the plane of the isocentre, m, `arch_centre` in its middle: then a
            millimetre has as many pixels in every anatomy. None: what holds the phantom's bounding box.

    Raises:
        ValueError: an unknown view, or a field that is no positive length.
    """
    if field is None or view not in VIEWS:
        return Projector.view(view, phantom.bounds, size)
    require_field(field)
    primary, secondary = VIEWS[view]
    return Projector.c_arm(
        centre=arch_centre(phantom, field),
        field_of_view=field,
        size=size,
        primary_deg=primary,
        secondary_deg=secondary,
        name=view,
    )


def field_projections(views: Sequence[str], field: float) -> NDArray[np.float64]:
    """How views with a field see what lies about their isocentre, the same in every anatomy.

    Args:
        views: names of `cathsim.fluoroscopy.projector.VIEWS`.
        field: side of the square that the images show in the plane of the isocentre, m.

    Returns:
        Matrices from homogeneous places, m from the isocentre, to columns and rows as shares of the image's side, 0 at
        its upper left corner. Shape (views, 3, 4).

    Raises:
        ValueError: an unknown view, or a field that is no positive length.
    """
    require_field(field)
    to_share = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # of a pixel, whose middle is at 0
    matrices = []
    for view in views:
        if view not in VIEWS:
            raise ValueError(f"unknown view {view!r}: expected one of {', '.join(VIEWS)}")
        primary, secondary = VIEWS[view]
        camera = Projector.c_arm(
            centre=np.zeros(3), field_of_view=field, size=1, primary_deg=primary, secondary_deg=secondary, name=view
        )
        matrices.append(to_share @ camera.P)
    return np.stack(matrices)
