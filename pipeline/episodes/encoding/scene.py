"""The 3-D scene of an episode for viewers: the phantom's wall, target and entry, and the devices at every step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from numpy.typing import NDArray

from pipeline.episodes.encoding.schema import WORLD_FRAME

FloatArray = NDArray[np.float64]

_WALL_COLOUR = Color(r=0.85, g=0.45, b=0.45, a=0.35)
_LINES = {  # entity: colour, width in pixels
    "wire": (Color(r=0.1, g=0.1, b=0.15, a=1.0), 3.0),
    "catheter": (Color(r=0.25, g=0.45, b=0.85, a=0.8), 6.0),
}
_TARGET_COLOUR = Color(r=0.1, g=0.7, b=0.2, a=0.8)
_ENTRY_COLOUR = Color(r=0.2, g=0.4, b=0.9, a=0.8)
_SPHERE_DIAMETER = 0.004


def _points(points: FloatArray) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in points.tolist()]


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
    def _triangles(self) -> TriangleListPrimitive:
        indices = self.faces.ravel().tolist()
        return TriangleListPrimitive(
            points=_points(self.vertices), indices=indices, color=_WALL_COLOUR, pose=_identity_pose()
        )

    def scene(self, time_ns: int) -> bytes:
        """Serialise as `foxglove.SceneUpdate` with the entities "phantom", "target" and "entry"."""
        entities = [_entity("phantom", time_ns, triangles=[self._triangles])]
        for name, centre, colour in (("target", self.target, _TARGET_COLOUR), ("entry", self.entry, _ENTRY_COLOUR)):
            sphere = SpherePrimitive(color=colour, pose=_identity_pose())
            x, y, z = centre.tolist()
            sphere.pose.position.x, sphere.pose.position.y, sphere.pose.position.z = x, y, z
            sphere.size.x = sphere.size.y = sphere.size.z = _SPHERE_DIAMETER
            entities.append(_entity(name, time_ns, spheres=[sphere]))
        return bytes(SceneUpdate(entities=entities).SerializeToString())


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


def _entity(name: str, time_ns: int, **shapes: Any) -> SceneEntity:
    entity = SceneEntity(id=name, frame_id=WORLD_FRAME, **shapes)
    entity.timestamp.FromNanoseconds(time_ns)
    return entity


def encode_wire_line(points: FloatArray, time_ns: int, device: str = "wire") -> bytes:
    """Serialise a device, (n, 3) m, world, tip first, as a `foxglove.SceneUpdate` that replaces the line before."""
    colour, width = _LINES[device]
    line = LinePrimitive(
        type=LinePrimitive.LINE_STRIP, thickness=width, scale_invariant=True, color=colour, pose=_identity_pose(),
        points=_points(points),
    )  # fmt: skip
    return bytes(SceneUpdate(entities=[_entity(device, time_ns, lines=[line])]).SerializeToString())


def encode_wire_points(points: FloatArray, time_ns: int) -> bytes:
    """Serialise a device, (n, 3) m, world, tip first, as a `foxglove.PointCloud` of float32; `/step` is exact."""
    data = points.astype("<f4").tobytes()
    cloud = PointCloud(frame_id=WORLD_FRAME, point_stride=12, pose=_identity_pose(), data=data)
    cloud.timestamp.FromNanoseconds(time_ns)
    for axis, name in enumerate("xyz"):
        cloud.fields.add(name=name, offset=4 * axis, type=PackedElementField.FLOAT32)
    return bytes(cloud.SerializeToString())
