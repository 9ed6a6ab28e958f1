"""X-ray scenes between source and detector: the body as solids, the vessel's wall and the filling of the lumen."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray
from pydantic import InstanceOf

from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.fluoroscopy.projector import Array, Projector
from cathsim.validation import Coordinate, Length, Listed, Unit, settings

_Place = Annotated[tuple[Coordinate, Coordinate, Coordinate], Listed]
_Size = Annotated[tuple[Length, Length, Length], Listed]
_Attenuation = Annotated[float, Interval(ge=-1e6, le=1e6), Unit("1/m")]
# what fills the lumen, mg/ml of iodine; None is air
FILLINGS: dict[str, float | None] = {"fluid": 0.0, "contrast": 40.0, "air": None}

_Over = Annotated[float, Interval(ge=-1e6, le=1e6), Unit("1/m")]  # attenuation over that of what surrounds


@settings
class Ellipsoid:
    """A solid of uniform extra attenuation; solids add where they overlap."""

    centre: _Place  # m, from the phantom's centre, along the world's axes
    semi_axes: _Size  # m, along the world's axes
    attenuation: _Attenuation  # 1/m, added to what the solid lies in; negative for air in tissue

    def chord(self, source: Array, directions: Array) -> Array:
        """Length (...) m of rays inside.

        Args:
            source: (3,) m, where the rays start, from the phantom's centre; outside the solid.
            directions: (..., 3) unit vectors.
        """
        # Where the solid is scaled to the unit sphere, a quadratic in s gives where start + s * direction meets it.
        axes = np.asarray(self.semi_axes)
        start = (source - np.asarray(self.centre)) / axes
        along = directions / axes
        a = np.einsum("...i,...i->...", along, along)
        b = along @ start
        return 2 * np.sqrt(np.maximum(b * b - a * (start @ start - 1.0), 0.0)) / a


@settings
class Box:
    """A block of uniform extra attenuation, its faces across the world's axes."""

    centre: _Place  # m, from the phantom's centre, along the world's axes
    half_sides: _Size  # m, along the world's axes
    attenuation: _Attenuation  # 1/m, added to what the block lies in

    def chord(self, source: Array, directions: Array) -> Array:
        """Length of rays inside, as `Ellipsoid.chord` gives it."""
        start = source - np.asarray(self.centre)
        enter, leave = np.zeros(directions.shape[:-1]), np.full(directions.shape[:-1], np.inf)
        for axis, half in enumerate(self.half_sides):  # axis by axis: reductions over three numbers take far longer
            slope = directions[..., axis]
            slope = np.where(np.abs(slope) < 1e-12, 1e-12, slope)
            one, other = (-half - start[axis]) / slope, (half - start[axis]) / slope
            np.maximum(enter, np.minimum(one, other), out=enter)
            np.minimum(leave, np.maximum(one, other), out=leave)
        return np.maximum(leave - enter, 0.0)


class MeasuredBody:
    """A body that was measured rather than put together, as a CT: `chord` gives optical depths."""

    attenuation = 1.0

    def chord(self, source: Array, directions: Array) -> Array:
        """Optical depth (...) of rays from a source (3,) m, from the phantom's centre, along (..., 3) unit vectors."""
        raise NotImplementedError


Solid = Ellipsoid | Box | InstanceOf[MeasuredBody]


def _spine() -> tuple[Ellipsoid, ...]:
    """A column of bone with a denser body at each vertebra."""
    column = Ellipsoid((0.0, 0.060, 0.0), (0.016, 0.017, 0.60), 4.0)
    vertebrae = (Ellipsoid((0.0, 0.060, 0.026 * i), (0.020, 0.017, 0.0125), 5.0) for i in range(-7, 8))
    return (column, *vertebrae)


def _lung(side: float) -> tuple[Ellipsoid, ...]:
    """A lung whose border is soft in the picture, as several of different size."""
    return tuple(
        Ellipsoid((side * 0.118, 0.0, -0.045), (width, 0.085, height), -0.8)
        for width, height in ((0.078, 0.165), (0.070, 0.152), (0.061, 0.139))
    )


# Linear attenuation near 60 keV is 20.5 per metre in soft tissue. Lungs and bone stand out less than in life: the image
# spends its grey levels on vessel and wire.
THORAX: tuple[Solid, ...] = (
    Ellipsoid((0.0, 0.0, 0.0), (0.19, 0.115, 0.60), 20.5),
    *_lung(-1.0),
    *_lung(1.0),
    *_spine(),
)


# A silicone phantom's transparent box: water in 8 mm of acrylic, on rails; linear attenuation near 60 keV.
WATER_BATH: tuple[Solid, ...] = (
    Box((0.0, 0.0, 0.0), (0.158, 0.075, 0.190), 22.9),
    Box((0.0, 0.0, 0.0), (0.150, 0.067, 0.182), -2.3),
    Box((0.0, 0.095, 0.030), (0.300, 0.012, 0.400), 6.0),
    Box((0.0, -0.090, 0.062), (0.200, 0.004, 0.030), 20.0),
    Box((-0.104, 0.0, 0.05), (0.008, 0.050, 0.110), 6.0),
)


def body_depth(projector: Projector, body: tuple[Solid, ...], origin: NDArray[np.float64]) -> NDArray[np.float32]:
    """Optical depth (height, width) of a body, whose origin is at (3,) m in the world, along every pixel's ray."""
    u, v = np.meshgrid(np.arange(projector.width, dtype=np.float64), np.arange(projector.height, dtype=np.float64))
    directions = np.stack([u, v, np.ones_like(u)], axis=-1) @ projector.rays.T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    depth = np.zeros(u.shape)
    for solid in body:
        depth += solid.attenuation * solid.chord(projector.source - origin, directions)
    return depth.astype(np.float32)


@settings
class XRayScene:
    """A vessel in its surroundings; attenuations are over those of what surrounds it."""

    name: str  # of the scene
    body: tuple[Solid, ...]  # solids about the vessel's centre
    surroundings: Annotated[float, Interval(ge=0, le=1e6), Unit("1/m")]  # attenuation of what the vessel lies in, 1/m
    wall: _Over  # attenuation of the vessel's wall over it, 1/m
    wall_thickness: Annotated[float, Interval(ge=0, le=0.1), Unit("m")]  # m
    filling: _Over  # attenuation of the lumen's content over it, 1/m
    scatter: Annotated[float, Interval(ge=0, lt=1)]  # share of scattered photons among those detected behind the body
    # grey level that the automatic brightness gives to the middle of the image
    middle: Annotated[float, Interval(gt=0, lt=255), Unit("grey levels")] = 140.0

    def filled(self, content: str) -> XRayScene:
        """The same scene with another content of the lumen.

        Args:
            content: "fluid" (what surrounds it), "contrast" (40 mg/ml of iodine) or "air".

        Raises:
            ValueError: for an unknown content.
        """
        if content not in FILLINGS:
            raise ValueError(f"unknown filling {content!r}: expected one of {', '.join(FILLINGS)}.")
        iodine = FILLINGS[content]
        filling = -self.surroundings if iodine is None else iodine * ATTENUATION["iodine_mg_per_ml"]
        return replace(self, filling=filling)


SCENES: dict[str, XRayScene] = {
    "bath": XRayScene(
        "bath",
        WATER_BATH,
        surroundings=ATTENUATION["water"],
        wall=ATTENUATION["silicone"] - ATTENUATION["water"],
        wall_thickness=0.0018,
        filling=0.0,
        scatter=0.12,
    ),
    "patient": XRayScene(
        "patient", THORAX, surroundings=20.5, wall=0.5, wall_thickness=0.002, filling=0.0, scatter=0.25, middle=120.0
    ),
    "empty": XRayScene("empty", (), surroundings=0.0, wall=0.0, wall_thickness=0.0, filling=0.0, scatter=0.0),
}


def scene(name: str, filling: str = "fluid") -> XRayScene:
    """A scene by name.

    Args:
        name: "bath" (a silicone phantom in a water bath), "patient" (thorax with lungs and spine) or "empty".
        filling: of the lumen, "fluid", "contrast" or "air".

    Raises:
        ValueError: for an unknown name or filling.
    """
    if name not in SCENES:
        raise ValueError(f"unknown scene {name!r}: expected one of {', '.join(SCENES)}.")
    return SCENES[name].filled(filling)
