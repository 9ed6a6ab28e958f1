"""The camera of an episode: a calibrated 3x4 projection, and its calibration and transform messages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from numpy.typing import NDArray

from pipeline.episodes.encoding.schema import WORLD_FRAME
from pipeline.settings.kinds import shown

FloatArray = NDArray[np.float64]

LONGEST_EDGE = 8192
"""Pixels along an edge of a camera's picture."""


def require_name(name: object) -> str:
    """Accept a camera's name: topics, entities of viewers and files of exports are named after it."""
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.-]{0,63}", name):
        raise ValueError(f"a camera's name must be a word of at most 64 letters, got {shown(name)}")
    return name


def camera_frame(name: str) -> str:
    """Name the frame of a camera: origin at the source, x right and y down in the image, z into it."""
    return f"camera/{name}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """A pinhole camera with P ~ K [R t]: world points in metres to pixels."""

    P: FloatArray  # (3, 4), px, up to scale
    K: FloatArray  # (3, 3), px
    R: FloatArray  # (3, 3), world to camera
    t: FloatArray  # (3,), m: the world's origin in the camera frame
    width: int
    height: int

    def __post_init__(self) -> None:
        for name, shape in (("P", (3, 4)), ("K", (3, 3)), ("R", (3, 3)), ("t", (3,))):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(f"{name} must be {shape} and finite, got {array.shape}: {array.tolist()}")
            object.__setattr__(self, name, array)
        for name in ("width", "height"):
            pixels = getattr(self, name)
            if not isinstance(pixels, int | np.integer) or not 1 <= pixels <= LONGEST_EDGE:
                raise ValueError(f"{name} must be a whole number of pixels from 1 to {LONGEST_EDGE}, got {pixels}")
        if not np.allclose(self.R @ self.R.T, np.eye(3), atol=1e-6):
            raise ValueError(f"R must be orthonormal, got R R^T = {(self.R @ self.R.T).tolist()}")
        product = self.K @ np.column_stack((self.R, self.t))
        projection = self.P / np.linalg.norm(self.P)
        product /= np.linalg.norm(product)
        if not np.allclose(projection * np.sign(np.sum(projection * product)), product, atol=1e-6):
            raise ValueError(f"P must be K [R t] up to scale, got {projection.tolist()} and {product.tolist()}")

    def calibration(self, name: str, time_ns: int) -> bytes:
        """Serialise as `foxglove.CameraCalibration`; P is [K 0] there, and the pose is in `transform`."""
        message = CameraCalibration(frame_id=camera_frame(name), width=self.width, height=self.height)
        message.timestamp.FromNanoseconds(time_ns)
        message.K.extend(self.K.ravel().tolist())
        message.R.extend(np.eye(3).ravel().tolist())
        message.P.extend(np.column_stack((self.K, np.zeros(3))).ravel().tolist())
        return bytes(message.SerializeToString())

    def transform(self, name: str, time_ns: int) -> FrameTransform:
        """Give the pose as `foxglove.FrameTransform`: source in m, rotation camera to world as a unit quaternion."""
        from scipy.spatial.transform import Rotation

        message = FrameTransform(parent_frame_id=WORLD_FRAME, child_frame_id=camera_frame(name))
        message.timestamp.FromNanoseconds(time_ns)
        x, y, z = (-self.R.T @ self.t).tolist()
        message.translation.x, message.translation.y, message.translation.z = x, y, z
        rotation = Rotation.from_matrix(self.R.T).as_quat().tolist()
        message.rotation.x, message.rotation.y, message.rotation.z, message.rotation.w = rotation
        return message

    def to_json(self) -> dict[str, Any]:
        """Give the matrices as plain JSON values, which keep every bit of a double."""
        arrays = {name: getattr(self, name).tolist() for name in ("P", "K", "R", "t")}
        return {**arrays, "width": int(self.width), "height": int(self.height)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Camera:
        """Read what `to_json` gave."""
        return cls(**{name: values[name] for name in ("P", "K", "R", "t", "width", "height")})
