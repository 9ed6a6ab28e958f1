"""Pairs of C-arm cameras, that of the public biplane data set and a clinical one, and their calibration on disk."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cathsim.fluoroscopy.detector import Detector
from cathsim.fluoroscopy.distortion import DetectorDistortion
from cathsim.fluoroscopy.projector import Projector

# The public biplane data set: distance between the sources, angle between the axes, focal lengths for 1024 px.
SOURCE_TO_SOURCE = 1.32  # m
BETWEEN_AXES_DEG = 91.0
FOCAL_PX = {"a": 5150.0, "b": 4450.0}
INTENSIFIER_DIAMETER = 16 * 0.0254  # m, taken to fill the collimator's circle
_SIZE = 1024
CLINICAL_FIELD = 0.25  # m in the plane of the isocentre
# The shafts of six published pairs run 6 degrees out of the plane of both optical axes, so the patient lies askew by as
# much. In that plane a whole shaft would lie on one epiline, and its depth could not be seen.
_ASKEW = np.radians(6.0)


TEXT_UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}  # world units per metre
_HEADINGS = ("image size", "camera matrix", "rotation", "translation")


@dataclass(frozen=True, eq=False)
class XRayCamera:
    """A source and a detector."""

    projector: Projector  # where the pinhole at the source sees a point
    distortion: DetectorDistortion  # where the detector shows it
    detector: Detector  # light, blur and noise

    def __post_init__(self) -> None:
        ours, theirs = (self.projector.width, self.projector.height), (self.distortion.width, self.distortion.height)
        if ours != theirs:
            raise ValueError(
                f"the distortion is made for {theirs} px and the camera has {ours} px: resize one of them."
            )

    @property
    def name(self) -> str:
        """Of the view."""
        return self.projector.name

    def resized(self, size: int) -> XRayCamera:
        """The same camera with another number of pixels (the shorter side) over the same field."""
        projector = self.projector.resized(size)
        return replace(self, projector=projector, distortion=self.distortion.resized(projector.width, projector.height))

    def pixels(self, points: ArrayLike) -> np.ndarray:
        """Where world points (n, 3) m are shown, (n, 2) px, distorted."""
        return self.distortion.distort(self.projector.project(points))

    def to_json(self) -> dict[str, Any]:
        """Matrices, distances and distortion as plain JSON values."""
        projector = self.projector
        matrices = {key: getattr(projector, key).tolist() for key in ("P", "K", "R", "t")}
        return {
            "name": self.name,
            "width": projector.width,
            "height": projector.height,
            **matrices,
            "source_m": projector.source.tolist(),
            "source_detector_distance_m": projector.source_detector_distance,
            "distortion": self.distortion.to_json(),
        }


def guide3d_pair(centre: ArrayLike, size: int = _SIZE) -> tuple[XRayCamera, XRayCamera]:
    """Cameras "a" and "b" of the public biplane data set, both axes in the plane of the patient's front and long axis.

    Sources 1.32 m apart, axes 91 degrees apart through one point, focal lengths of 5,150 (a) and 4,450 px (b), the same
    scale of 0.192 mm/px in both there; the patient's head is to the right of both images, half turned to the cameras.

    Args:
        centre: (3,) m, where the axes meet.
        size: px, side of the square images.
    """
    # one scale p at the crossing makes both distances p f; the law of cosines over the baseline gives p
    a, b = FOCAL_PX["a"], FOCAL_PX["b"]
    scale = SOURCE_TO_SOURCE / np.sqrt(a * a + b * b - 2 * a * b * np.cos(np.radians(BETWEEN_AXES_DEG)))
    detectors = {
        "a": Detector(field_radius=1.228, field_centre=(-0.012, -0.035), penumbra=18.0, vignette=0.74, glare=2.0),
        "b": Detector(
            field_radius=1.160, field_centre=(-0.008, 0.028), penumbra=50.0, vignette=0.66, glare=5.0, heel=0.15
        ),
    }
    distortions = {
        "a": DetectorDistortion(_SIZE, _SIZE, 0.055, -0.0215, -0.016, tilt=(0.0038, -0.0018), centre=(-0.05, 0.07)),
        "b": DetectorDistortion(_SIZE, _SIZE, 0.056, -0.0225, 0.017, tilt=(-0.0036, 0.0025), centre=(0.05, 0.05)),
    }
    cameras = []
    for name, side in (("a", 1.0), ("b", -1.0)):
        field = detectors[name].field_radius
        assert field is not None
        projector = Projector.c_arm(
            centre=centre,
            field_of_view=float(scale * _SIZE),
            size=_SIZE,
            secondary_deg=side * BETWEEN_AXES_DEG / 2,
            roll_deg=90.0,
            source_detector_distance=FOCAL_PX[name] * INTENSIFIER_DIAMETER / (field * _SIZE),
            source_object_distance=float(scale * FOCAL_PX[name]),
            name=name,
        )
        camera = XRayCamera(projector, distortions[name], detectors[name])
        cameras.append(camera if size == _SIZE else camera.resized(size))
    return cameras[0], cameras[1]


def askew_pair(centre: ArrayLike, size: int = _SIZE, *, distorted: bool = True) -> dict[str, XRayCamera]:
    """Makes the public pair over a patient who lies askew by 6 degrees, as generated data sets and navigation use it.

    The pair is turned about the middle of its viewing directions, through the point where its axes meet.

    Args:
        centre: (3,) m, where the axes meet.
        size: px, side of the square images.
        distorted: whether images show the detectors' distortion.

    Returns:
        Cameras "a" and "b" by name.
    """
    pair = guide3d_pair(centre, size)
    a, b = (camera.projector for camera in pair)
    axis = (a.R[2] + b.R[2]) / np.linalg.norm(a.R[2] + b.R[2])
    turn = Rotation.from_rotvec(_ASKEW * axis).as_matrix()
    turned = {}
    for camera in pair:
        projector, R = camera.projector, camera.projector.R @ turn.T
        source = np.asarray(centre) + turn @ (projector.source - np.asarray(centre))
        distortion = camera.distortion if distorted else DetectorDistortion.none(size, size)
        turned[camera.name] = replace(camera, projector=replace(projector, R=R, t=-R @ source), distortion=distortion)
    return turned


def clinical_pair(centre: ArrayLike, size: int = _SIZE) -> tuple[XRayCamera, XRayCamera]:
    """A frontal (a) and a lateral (b) C-arm with flat panels: upright, without distortion or a round collimator.

    Args:
        centre: (3,) m, isocentre.
        size: px, side of the square images.
    """
    panel = Detector(field_radius=None, glare=0.0, screen_blur=0.8, photons=1200.0, equalisation=0.7)
    a, b = (
        XRayCamera(
            Projector.c_arm(centre=centre, field_of_view=CLINICAL_FIELD, size=size, primary_deg=primary, name=name),
            DetectorDistortion.none(size, size),
            panel,
        )
        for name, primary in (("a", 0.0), ("b", 90.0))
    )
    return a, b


PAIRS: dict[str, Callable[..., tuple[XRayCamera, XRayCamera]]] = {"guide3d": guide3d_pair, "clinical": clinical_pair}


def write_calibration(cameras: Mapping[str, XRayCamera], folder: Path, *, unit: str = "cm") -> list[Path]:
    """Writes `calibration.json` (SI, with the distortion) and a `projection_<name>.txt` for every camera.

    Args:
        cameras: by name, e.g. those of a `BiplaneFluoroscope`.
        folder: is made where it is missing.
        unit: of the world in the text files, "cm" as laboratories write them, "mm" or "m".

    Returns:
        The files, JSON first.

    Raises:
        ValueError: for an unknown unit.
    """
    if unit not in TEXT_UNITS:
        raise ValueError(f"unknown unit {unit!r}: expected one of {', '.join(TEXT_UNITS)}.")
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / "calibration.json"]
    content = {"unit": "m", "cameras": {name: camera.to_json() for name, camera in cameras.items()}}
    written[0].write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    for name, camera in cameras.items():
        projector = camera.projector
        sections: tuple[np.ndarray, ...] = (
            np.array([[projector.width, projector.height]]),
            projector.K,
            projector.R,
            projector.t[:, None] * TEXT_UNITS[unit],
        )
        blocks = (
            "\r\n".join([heading, *(",".join(f"{value:.12g}" for value in row) for row in rows)]) + "\r\n"
            for heading, rows in zip(_HEADINGS, sections, strict=True)
        )
        path = folder / f"projection_{name}.txt"
        path.write_bytes("\r\n".join(blocks).encode("ascii"))
        written.append(path)
    return written
