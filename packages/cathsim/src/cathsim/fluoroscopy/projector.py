"""C-arm cameras: a pinhole at the X-ray source, from world points to pixels."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import ArrayLike, NDArray
from pydantic import SkipValidation

from cathsim.validation import Length, Unit, quantity, settings

Array = NDArray[np.float64]

SOURCE_DETECTOR_DISTANCE = 1.2  # m
SOURCE_OBJECT_DISTANCE = 0.75  # m
MARGIN = 0.04  # of the field of view, left free on each side of the phantom

# (primary, secondary) angle in degrees of the views that have a name
VIEWS: dict[str, tuple[float, float]] = {
    "frontal": (0.0, 0.0),
    "lateral": (90.0, 0.0),
    "lao_45": (45.0, 0.0),
    "rao_30": (-30.0, 0.0),
    "cranial_30": (0.0, 30.0),
    "caudal_30": (0.0, -30.0),
}


# a camera that is distorted, or drawn coarsely, looks at more pixels than its image has
_Degrees = Annotated[float, Interval(ge=-360, le=360), Unit("degrees")]
_Side = Annotated[int, Interval(ge=1, le=32768), Unit("px")]


@settings(eq=False)
class Projector:
    """A pinhole camera with square pixels whose centre is the X-ray source.

    World frame: +x patient left, +y posterior, +z superior. Camera frame: x to the right of the image, y down, z from
    the source to the detector. The pixel (0, 0) is the centre of the top-left pixel, u runs right and v down. The
    frontal view shows the patient as seen from the front: head up, the patient's left on the right. Its source stands
    in front of the patient, so that the matrix is a proper camera (det R = +1); a tube below the table would ask for a
    mirrored image.

    Attributes:
        K: (3, 3) camera to pixel, px.
        R: (3, 3) world to camera rotation.
        t: (3,) m, the world's origin in the camera frame.
        width: px.
        height: px.
        name: of the view, as used for topics and files.
        source_detector_distance: m; no pixel depends on it.
    """

    K: Annotated[Array, SkipValidation]
    R: Annotated[Array, SkipValidation]
    t: Annotated[Array, SkipValidation]
    width: _Side
    height: _Side
    name: str = "frontal"
    source_detector_distance: Length = SOURCE_DETECTOR_DISTANCE

    def __post_init__(self) -> None:
        for field, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,))):
            array = np.array(getattr(self, field), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(f"a projector's {field} must be finite with shape {shape}, got {array.tolist()}.")
            array.flags.writeable = False
            object.__setattr__(self, field, array)
        if not np.allclose(self.R @ self.R.T, np.eye(3), atol=1e-6) or np.linalg.det(self.R) < 0:
            raise ValueError("a projector's R must be a rotation (orthonormal, determinant +1); check its rows.")

    @classmethod
    def c_arm(
        cls,
        *,
        centre: ArrayLike,
        field_of_view: float,
        size: int | tuple[int, int],
        primary_deg: float = 0.0,
        secondary_deg: float = 0.0,
        roll_deg: float = 0.0,
        source_detector_distance: float = SOURCE_DETECTOR_DISTANCE,
        source_object_distance: float = SOURCE_OBJECT_DISTANCE,
        name: str = "frontal",
    ) -> Projector:
        """Camera of a C-arm that turns about an isocentre.

        Args:
            centre: (3,) m, isocentre in the world frame; it falls on the middle of the image.
            field_of_view: m, extent of the shorter image side in the plane of the isocentre.
            size: px, the side of a square image or (width, height).
            primary_deg: degrees towards the patient's left (LAO positive, RAO negative).
            secondary_deg: degrees towards the head (cranial positive, caudal negative).
            roll_deg: degrees by which the image is turned clockwise; 90 puts the head on its right.
            source_detector_distance: m.
            source_object_distance: m, from the source to the isocentre.

        Raises:
            ValueError: for distances that are not 0 < source to object < source to detector, an empty field or image,
                or a secondary angle at which the image has no upright direction.
        """
        width, height = size if isinstance(size, tuple | list) else (size, size)
        width, height = quantity("width", width, _Side), quantity("height", height, _Side)
        for angle, value in (("primary", primary_deg), ("secondary", secondary_deg), ("roll", roll_deg)):
            quantity(f"{angle}_deg", value, _Degrees)
        middle = np.asarray(centre, dtype=np.float64)
        if middle.shape != (3,):
            raise ValueError(f"the isocentre must have shape (3,), got {middle.shape}.")
        if not 0 < source_object_distance < source_detector_distance:
            raise ValueError(
                "the object must lie between source and detector: expected 0 < source_object_distance < "
                f"source_detector_distance, got {source_object_distance} m and {source_detector_distance} m."
            )
        if not (field_of_view > 0 and np.isfinite(field_of_view)):
            raise ValueError(f"the field of view must be a positive length, got {field_of_view!r} m.")
        if not abs(secondary_deg) < 89:
            raise ValueError(f"the secondary angle must lie between -89 and 89 degrees, got {secondary_deg!r}.")
        R = view_rotation(primary_deg, secondary_deg, roll_deg)
        source = middle - source_object_distance * R[2]
        focal = min(width, height) * source_object_distance / field_of_view
        K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
        return cls(K, R, -R @ source, width, height, name, source_detector_distance)

    @classmethod
    def view(cls, name: str, bounds: ArrayLike, size: int | tuple[int, int], **geometry: float) -> Projector:
        """Named view whose field holds the whole of a phantom's bounding box.

        Args:
            bounds: (2, 3) m, lowest and highest corner in the world frame.
            size: px, the side of a square image or (width, height).
            geometry: source_detector_distance and source_object_distance in m, if not the usual ones.

        Raises:
            ValueError: for an unknown name or bounds that are not two ordered corners.
        """
        if name not in VIEWS:
            raise ValueError(f"unknown view {name!r}: expected one of {', '.join(VIEWS)}.")
        box = np.asarray(bounds, dtype=np.float64)
        if box.shape != (2, 3) or not (box[0] < box[1]).all():
            raise ValueError(f"bounds must be the lowest and the highest corner, shape (2, 3), got {box.tolist()}.")
        primary, secondary = VIEWS[name]
        wide = cls.c_arm(
            centre=box.mean(axis=0),
            field_of_view=1.0,
            size=size,
            primary_deg=primary,
            secondary_deg=secondary,
            name=name,
            **geometry,
        )
        corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        half = np.array([wide.width, wide.height]) / 2
        filled = np.abs(wide.project(corners) - (half - 0.5)).max(axis=0) / half
        zoom = (1 - 2 * MARGIN) / filled.max()
        return replace(wide, K=wide.K * [[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]])

    @classmethod
    def frontal(cls, bounds: ArrayLike, size: int | tuple[int, int]) -> Projector:
        """Frontal view of a phantom: `view("frontal", bounds, size)`."""
        return cls.view("frontal", bounds, size)

    @property
    def P(self) -> Array:
        """(3, 4) matrix from homogeneous world points (m) to homogeneous pixels."""
        return self.K @ np.column_stack([self.R, self.t])

    @property
    def source(self) -> Array:
        """(3,) m, the X-ray source in the world frame."""
        return -self.R.T @ self.t

    @property
    def rays(self) -> Array:
        """(3, 3) matrix from homogeneous pixels to world directions, away from the source."""
        return self.R.T @ np.linalg.inv(self.K)

    @property
    def key(self) -> str:
        """Short digest of the geometry, for caches."""
        parts = (self.K.tobytes(), self.R.tobytes(), self.t.tobytes(), f"{self.width}x{self.height}".encode())
        return hashlib.sha256(b"".join(parts)).hexdigest()[:16]

    def project(self, points: ArrayLike) -> Array:
        """Pixels (n, 2) of world points (n, 3) m, u right and v down; outside the image is allowed.

        Raises:
            ValueError: for another shape or a point that is not in front of the source.
        """
        world = np.asarray(points, dtype=np.float64)
        if world.ndim != 2 or world.shape[1] != 3:
            raise ValueError(f"points to project must have shape (n, 3), got {world.shape}.")
        camera = world @ self.R.T + self.t
        if not (camera[:, 2] > 0).all():
            raise ValueError("every point to project must be finite and in front of the X-ray source; move the camera.")
        pixels = camera @ self.K.T
        return pixels[:, :2] / pixels[:, 2:]

    def pixels_per_metre(self, point: ArrayLike) -> float:
        """Image scale (px/m) at a point (3,) m, parallel to the detector."""
        depth = float(self.R[2] @ np.asarray(point, dtype=np.float64) + self.t[2])
        return float(self.K[0, 0]) / depth

    def resized(self, size: int) -> Projector:
        """The same view with another number of pixels (the shorter side) over the same field.

        Pixel centres move by the half pixel that the change of scale asks for.
        """
        scale = size / min(self.width, self.height)
        shift = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]])
        width, height = round(self.width * scale), round(self.height * scale)
        return replace(self, K=shift @ self.K, width=width, height=height)


def view_rotation(primary_deg: float, secondary_deg: float, roll_deg: float = 0.0) -> Array:
    """Rotation (3, 3) from the world to the camera of a C-arm; angles as `Projector.c_arm` has them.

    Its rows are the image's right, its down, and the direction from source to detector.
    """
    primary, secondary = np.radians(primary_deg), np.radians(secondary_deg)
    right = np.array([np.cos(primary), np.sin(primary), 0.0])
    towards_source = np.array(
        [np.sin(primary) * np.cos(secondary), -np.cos(primary) * np.cos(secondary), np.sin(secondary)]
    )
    upright = np.stack([right, np.cross(-towards_source, right), -towards_source])
    if not roll_deg:
        return upright
    cos, sin = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ upright
