"""The 3-D scene of an episode for viewers: the phantom's wall, target and entry, and the devices at every step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from numpy.typing import NDArray

from pipeline.episodes.encoding.schema import WORLD_FRAME
from pipeline.episodes.encoding.step_codec import DELIMITED, delimited, timestamp

FloatArray = NDArray[np.float64]

_WALL_COLOUR = Color(r=0.85, g=0.45, b=0.45, a=0.35)
_LINES = {  # entity: colour, width in pixels
    "wire": (Color(r=0.1, g=0.1, b=0.15, a=1.0), 3.0),
    "catheter": (Color(r=0.25, g=0.45, b=0.85, a=0.8), 6.0),
}
_TARGET_COLOUR = Color(r=0.1, g=0.7, b=0.2, a=0.8)
_ENTRY_COLOUR = Color(r=0.2, g=0.4, b=0.9, a=0.8)
_SPHERE_DIAMETER = 0.004

_POINT_BYTES = 29
"""A Point3 within a repeated field numbered below 16: key, length 27, then three keyed doubles."""


@lru_cache(maxsize=64)
def _point_rows(number: int, count: int) -> NDArray[np.uint8]:
    """Lay out so many points of a repeated Point3 field, coordinates yet to be filled in."""
    assert number < 16  # so that its key is one byte
    row = np.zeros(_POINT_BYTES, np.uint8)
    row[:2] = number << 3 | DELIMITED, _POINT_BYTES - 2
    row[[2, 11, 20]] = 0x09, 0x11, 0x19  # keys of the doubles x, y and z
    return np.tile(row, (count, 1))


def _points_field(number: int, points: FloatArray) -> bytes:
    """Serialise points as a repeated Point3 field, for all points at once."""
    count = len(points)
    rows = _point_rows(number, count).copy()
    coordinates = np.ascontiguousarray(points, dtype="<f8").view(np.uint8).reshape(count, 3, 8)
    rows[:, 2:].reshape(count, 3, 9, copy=False)[:, :, 1:] = coordinates
    return rows.tobytes()


@dataclass(frozen=True, eq=False, kw_only=True)
class PhantomMesh:
    """The phantom's wall as triangles, with the target and the entry.

    One object may serve many episodes: its encoded form is kept. A mesh of a few thousand faces keeps logs small.
    """

    vertices: FloatArray  # (n, 3), m, world
    faces: NDArray[np.uint32]  # (m, 3), indices into vertices
    target: FloatArray  # (3,), m, world
    entry: FloatArray  # (3,), m, world

    def __post_init__(self) -> None:
        for name in ("vertices", "target", "entry"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=np.float64))
        faces = np.asarray(self.faces)
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise ValueError(f"vertices must have shape (n, 3), got {self.vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise ValueError(f"faces must have shape (m, 3), got {faces.shape}")
        if faces.size and not (faces.min() >= 0 and faces.max() < len(self.vertices)):
            raise ValueError(f"faces must index {len(self.vertices)} vertices, got {faces.min()} to {faces.max()}")
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, dtype=np.uint32))
        for name in ("target", "entry"):
            if getattr(self, name).shape != (3,):
                raise ValueError(f"{name} must have shape (3,), got {getattr(self, name).shape}")

    @cached_property
    def _triangles(self) -> bytes:
        fields = TriangleListPrimitive.DESCRIPTOR.fields_by_name
        body = _points_field(fields["points"].number, self.vertices)
        body += delimited(fields["indices"].number, self.faces.astype("<u4").tobytes())
        body += delimited(fields["color"].number, _WALL_COLOUR.SerializeToString())
        body += delimited(fields["pose"].number, _identity_pose().SerializeToString())
        return delimited(SceneEntity.DESCRIPTOR.fields_by_name["triangles"].number, body)

    def scene(self, time_ns: int) -> bytes:
        """Serialise as `foxglove.SceneUpdate` with the entities "phantom", "target" and "entry"."""
        entities = SceneUpdate.DESCRIPTOR.fields_by_name["entities"].number
        update = delimited(entities, _entity_head("phantom", time_ns) + self._triangles)
        for name, centre, colour in (("target", self.target, _TARGET_COLOUR), ("entry", self.entry, _ENTRY_COLOUR)):
            sphere = SpherePrimitive(color=colour, pose=_identity_pose())
            x, y, z = centre.tolist()
            sphere.pose.position.x, sphere.pose.position.y, sphere.pose.position.z = x, y, z
            sphere.size.x = sphere.size.y = sphere.size.z = _SPHERE_DIAMETER
            spheres = SceneEntity.DESCRIPTOR.fields_by_name["spheres"].number
            body = delimited(spheres, sphere.SerializeToString())
            update += delimited(entities, _entity_head(name, time_ns) + body)
        return update


def decode_phantom(data: bytes) -> PhantomMesh:
    """Read what `PhantomMesh.scene` gave; a ValueError where an entity is missing."""
    entities = {entity.id: entity for entity in SceneUpdate.FromString(data).entities}
    if missing := {"phantom", "target", "entry"} - set(entities):
        raise ValueError(
            f"the phantom's scene must hold phantom, target and entry; {', '.join(sorted(missing))} missing"
        )
    if not (entities["phantom"].triangles and entities["target"].spheres and entities["entry"].spheres):
        raise ValueError("the phantom's scene must hold triangles for the phantom and spheres for target and entry")
    triangles = entities["phantom"].triangles[0]
    vertices = np.array([(p.x, p.y, p.z) for p in triangles.points], dtype=np.float64).reshape(-1, 3)
    centres = {}
    for name in ("target", "entry"):
        position = entities[name].spheres[0].pose.position
        centres[name] = np.array([position.x, position.y, position.z])
    if len(triangles.indices) % 3:
        raise ValueError(f"the phantom's faces must have three corners each, got {len(triangles.indices)} corners")
    faces = np.array(triangles.indices, dtype=np.uint32).reshape(-1, 3)
    return PhantomMesh(vertices=vertices, faces=faces, target=centres["target"], entry=centres["entry"])


def _identity_pose() -> Pose:
    pose = Pose()
    pose.orientation.w = 1.0
    pose.position.SetInParent()
    return pose


def _entity_head(entity_id: str, time_ns: int) -> bytes:
    fields = SceneEntity.DESCRIPTOR.fields_by_name
    return timestamp(fields["timestamp"].number, time_ns) + _entity_names(entity_id)


@lru_cache(maxsize=16)
def _entity_names(entity_id: str) -> bytes:
    fields = SceneEntity.DESCRIPTOR.fields_by_name
    return delimited(fields["frame_id"].number, WORLD_FRAME.encode()) + delimited(
        fields["id"].number, entity_id.encode()
    )


@lru_cache(maxsize=2)
def _line_style(device: str) -> bytes:
    """All of a line but its points."""
    colour, width = _LINES[device]
    line = LinePrimitive(type=LinePrimitive.LINE_STRIP, thickness=width, scale_invariant=True, color=colour)
    line.pose.CopyFrom(_identity_pose())
    return bytes(line.SerializeToString())


_LINE_POINTS = LinePrimitive.DESCRIPTOR.fields_by_name["points"].number
_ENTITIES = SceneUpdate.DESCRIPTOR.fields_by_name["entities"].number
_ENTITY_LINES = SceneEntity.DESCRIPTOR.fields_by_name["lines"].number
_CLOUD_TIME = PointCloud.DESCRIPTOR.fields_by_name["timestamp"].number
_CLOUD_DATA = PointCloud.DESCRIPTOR.fields_by_name["data"].number


def encode_wire_line(points: FloatArray, time_ns: int, device: str = "wire") -> bytes:
    """Serialise a device, (n, 3) m, world, tip first, as a `foxglove.SceneUpdate` that replaces the line before."""
    line = delimited(_ENTITY_LINES, _points_field(_LINE_POINTS, points) + _line_style(device))
    return delimited(_ENTITIES, _entity_head(device, time_ns) + line)


@lru_cache(maxsize=1)
def _cloud_layout() -> bytes:
    cloud = PointCloud(frame_id=WORLD_FRAME, point_stride=12, pose=_identity_pose())
    for axis, name in enumerate("xyz"):
        cloud.fields.add(name=name, offset=4 * axis, type=PackedElementField.FLOAT32)
    return bytes(cloud.SerializeToString())


def encode_wire_points(points: FloatArray, time_ns: int) -> bytes:
    """Serialise a device, (n, 3) m, world, tip first, as a `foxglove.PointCloud` of float32; `/step` is exact."""
    data = delimited(_CLOUD_DATA, points.astype("<f4").tobytes())
    return timestamp(_CLOUD_TIME, time_ns) + _cloud_layout() + data
