"""The schema of an episode log: its topics, its `endonav.Step` message, its units and its version.

| topic                        | message                    | when       | frame and unit                              |
|------------------------------|----------------------------|------------|---------------------------------------------|
| `/step`                      | endonav.Step               | every step | see the table of fields below               |
| `/camera/<name>/image`       | foxglove.CompressedImage   | every step | PNG, 8-bit grey; frame `camera/<name>`      |
| `/camera/<name>/mask`        | foxglove.CompressedImage   | every step | PNG, 1 bit, 1 = wire; frame `camera/<name>` |
| `/camera/<name>/calibration` | foxglove.CameraCalibration | once       | K and P = [K 0] in pixels, R = identity     |
| `/tf`                        | foxglove.FrameTransforms   | once       | `world` -> `camera/<name>`, m               |
| `/wire`                      | foxglove.SceneUpdate       | every step | line strip, tip first; `world`, m           |
| `/wire/points`               | foxglove.PointCloud        | every step | float32 x, y, z, tip first; `world`, m      |
| `/phantom`                   | foxglove.SceneUpdate       | once       | wall, target, entry; `world`, m             |

| field of endonav.Step | shape  | unit         | meaning                                                              |
|-----------------------|--------|--------------|----------------------------------------------------------------------|
| step                  | -      | -            | index i; record 0 is the state after reset                           |
| action                | (a,)   | -            | the action that led to this state, as given to the environment       |
| reward                | -      | -            | the reward of that action                                            |
| terminated, truncated | -      | -            | how Gymnasium says that an episode is over                           |
| joint_positions       | (q,)   | m or rad     | generalised positions                                                |
| joint_velocities      | (v,)   | m/s or rad/s | generalised velocities                                               |
| wire_points           | (n, 3) | m, world     | points along the wire, tip first                                     |
| tip                   | (3,)   | m, world     | the tip                                                              |
| contact_positions     | (k, 3) | m, world     | contacts of wire and wall                                            |
| contact_forces        | (k, 3) | N, world     | their forces on the wire                                             |
| resultant_force       | (3,)   | N, world     | resultant of the contact forces, at the substep where it was largest |
| resultant_force_norm  | -      | N            | its norm                                                             |
| insertion             | -      | m            | how far the wire was pushed in                                       |
| rotation              | -      | rad          | how far it was turned                                                |
| extra                 | map    | in the name  | further scalars                                                      |

The recorder's further scalars, which logs of before they existed lack: distance_m to the target; load_x_n, load_y_n,
load_z_n, the mean force on the vessel over the control step, and sheath_x_n, sheath_y_n, sheath_z_n, that on the sheath
(N, world); magnitude_sum_n, the mean sum of the contacts' magnitudes; largest_contact_n, the largest single contact.

Record i has log_time = start_time_ns + i * control step, so that a step index is a time. Two metadata records hold the
rest as JSON with its CRC-32: `endonav.episode` (written twice, so that one damaged byte cannot make a log anonymous)
and `endonav.outcome`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

SCHEMA_VERSION = 1
"""Version of the layout above; a reader refuses logs that are newer than itself."""

PROFILE = "endonav"
EPISODE_METADATA = "endonav.episode"
OUTCOME_METADATA = "endonav.outcome"

STEP_TOPIC = "/step"
WIRE_TOPIC = "/wire"
WIRE_POINTS_TOPIC = "/wire/points"
PHANTOM_TOPIC = "/phantom"
TRANSFORM_TOPIC = "/tf"
WORLD_FRAME = "world"

_Proto = descriptor_pb2.FieldDescriptorProto


class StepField(NamedTuple):
    """A field of `endonav.Step`: its number, its protobuf type and, for arrays, its shape (-1 is free)."""

    number: int
    type: int
    shape: tuple[int, ...] = ()


STEP_FIELDS: dict[str, StepField] = {
    "step": StepField(1, _Proto.TYPE_UINT64),
    "action": StepField(2, _Proto.TYPE_DOUBLE, (-1,)),
    "reward": StepField(3, _Proto.TYPE_DOUBLE),
    "terminated": StepField(4, _Proto.TYPE_BOOL),
    "truncated": StepField(5, _Proto.TYPE_BOOL),
    "joint_positions": StepField(6, _Proto.TYPE_DOUBLE, (-1,)),
    "joint_velocities": StepField(7, _Proto.TYPE_DOUBLE, (-1,)),
    "wire_points": StepField(8, _Proto.TYPE_DOUBLE, (-1, 3)),
    "tip": StepField(9, _Proto.TYPE_DOUBLE, (3,)),
    "contact_positions": StepField(10, _Proto.TYPE_DOUBLE, (-1, 3)),
    "contact_forces": StepField(11, _Proto.TYPE_DOUBLE, (-1, 3)),
    "resultant_force": StepField(12, _Proto.TYPE_DOUBLE, (3,)),
    "resultant_force_norm": StepField(13, _Proto.TYPE_DOUBLE),
    "insertion": StepField(14, _Proto.TYPE_DOUBLE),
    "rotation": StepField(15, _Proto.TYPE_DOUBLE),
}
EXTRA_FIELD_NUMBER = 16


def _build_step_message() -> Any:
    """Build the class of `endonav.Step` from its field table, without protoc."""
    file = descriptor_pb2.FileDescriptorProto(name="endonav/step.proto", package="endonav", syntax="proto3")
    message = file.message_type.add(name="Step")
    for name, field in STEP_FIELDS.items():
        label = _Proto.LABEL_REPEATED if field.shape else _Proto.LABEL_OPTIONAL
        message.field.add(name=name, number=field.number, type=field.type, label=label)
    entry = message.nested_type.add(name="ExtraEntry")
    entry.field.add(name="key", number=1, type=_Proto.TYPE_STRING, label=_Proto.LABEL_OPTIONAL)
    entry.field.add(name="value", number=2, type=_Proto.TYPE_DOUBLE, label=_Proto.LABEL_OPTIONAL)
    entry.options.map_entry = True
    message.field.add(
        name="extra",
        number=EXTRA_FIELD_NUMBER,
        type=_Proto.TYPE_MESSAGE,
        type_name=".endonav.Step.ExtraEntry",
        label=_Proto.LABEL_REPEATED,
    )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("endonav.Step"))


Step: Any = _build_step_message()
"""The protobuf class of the message on `/step`."""


def camera_topic(name: str, stream: str) -> str:
    """Name the topic of a camera's stream.

    Args:
        stream: "image", "mask" or "calibration".

    Returns:
        The topic, e.g. `/camera/frontal/image`.
    """
    return f"/camera/{name}/{stream}"


def topic_messages(cameras: tuple[str, ...]) -> dict[str, Any]:
    """List the topics of a log with their protobuf classes, in the order of their channel ids (1, 2, ...)."""
    topics: dict[str, Any] = {
        STEP_TOPIC: Step,
        WIRE_TOPIC: SceneUpdate,
        WIRE_POINTS_TOPIC: PointCloud,
        PHANTOM_TOPIC: SceneUpdate,
        TRANSFORM_TOPIC: FrameTransforms,
    }
    for name in cameras:
        topics[camera_topic(name, "calibration")] = CameraCalibration
        topics[camera_topic(name, "image")] = CompressedImage
        topics[camera_topic(name, "mask")] = CompressedImage
    return topics
