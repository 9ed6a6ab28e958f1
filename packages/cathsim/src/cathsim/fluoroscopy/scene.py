"""X-ray scenes between source and detector: the body, the vessel's wall and the filling of the lumen."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from annotated_types import Interval

from cathsim.fluoroscopy.body import THORAX, WATER_BATH, Solid
from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.validation import Unit, settings

# what fills the lumen, mg/ml of iodine; None is air
FILLINGS: dict[str, float | None] = {"fluid": 0.0, "contrast": 40.0, "air": None}


_Over = Annotated[float, Interval(ge=-1e6, le=1e6), Unit("1/m")]  # attenuation over that of what surrounds


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
