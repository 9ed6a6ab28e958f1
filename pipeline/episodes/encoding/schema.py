"""The schema of an episode log: its topics, its `endonav` messages, its units and its version.

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
| `/devices`                   | endonav.Devices            | every step | see the second table                        |
| `/catheter`                  | foxglove.SceneUpdate       | every step | as `/wire`                                  |
| `/catheter/points`           | foxglove.PointCloud        | every step | as `/wire/points`                           |
| `/camera/<name>/mask_wire`   | foxglove.CompressedImage   | every step | as the mask (of both devices), of the wire  |
| `/camera/<name>/mask_catheter` | foxglove.CompressedImage | every step | as the mask, of the catheter                |

The last five are only in logs whose configuration names a `catheter`; `/wire` and `/wire/points` then show the wire.

| field of endonav.Step | shape  | unit         | meaning                                                              |
|-----------------------|--------|--------------|----------------------------------------------------------------------|
| step                  | -      | -            | index i; record 0 is the state after reset                           |
| action                | (a,)   | -            | the action that led to this state, as given to the environment       |
| reward                | -      | -            | the reward of that action                                            |
| terminated, truncated | -      | -            | how Gymnasium says that an episode is over                           |
| joint_positions       | (q,)   | m or rad     | generalised positions                                                |
| joint_velocities      | (v,)   | m/s or rad/s | generalised velocities                                               |
| wire_points           | (n, 3) | m, world     | points along the wire, or the rod of both devices, tip first         |
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
A person's also have xray_on (1 or 0), whether the beam was on in the step; injections of contrast medium since the step
before; and force_warning (1 or 0), whether the contact force has risen to the operator's limit.

| field of endonav.Devices | shape  | unit     | meaning; pairs are wire, catheter                                     |
|--------------------------|--------|----------|-----------------------------------------------------------------------|
| step                     | -      | -        | as above                                                              |
| wire_points              | (n, 3) | m, world | points along the wire, its tip first; none where there is no wire     |
| catheter_points          | (m, 3) | m, world | points along the catheter, its tip first                              |
| insertions               | (2,)   | m        | how far the feeders have pushed them in                               |
| hub_rotations            | (2,)   | rad      | how far their hubs were turned                                        |
| tip_rotations            | (2,)   | rad      | how far their tips were; NaN of an absent device                      |
| lead                     | -      | m        | how far the wire's tip is before the catheter's; negative: behind     |
| feeder_forces            | (2,)   | N        | what the feeders push with                                            |
| hub_torques              | (2,)   | N m      | by which the hubs are held                                            |

The action of such a log has four numbers: translation and rotation of the wire, then those of the catheter.

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
DEVICES_TOPIC = "/devices"
CATHETER_TOPIC = "/catheter"
CATHETER_POINTS_TOPIC = "/catheter/points"
WORLD_FRAME = "world"
DEVICE_MASKS = ("mask_wire", "mask_catheter")  # streams of a camera, in a log with a catheter

_Proto = descriptor_pb2.FieldDescriptorProto


class StepField(NamedTuple):
    """A field of an `endonav` message: its number, its protobuf type and, for arrays, its shape (-1 is free)."""

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

DEVICE_FIELDS: dict[str, StepField] = {
    "step": StepField(1, _Proto.TYPE_UINT64),
    "wire_points": StepField(2, _Proto.TYPE_DOUBLE, (-1, 3)),
    "catheter_points": StepField(3, _Proto.TYPE_DOUBLE, (-1, 3)),
    "insertions": StepField(4, _Proto.TYPE_DOUBLE, (2,)),
    "hub_rotations": StepField(5, _Proto.TYPE_DOUBLE, (2,)),
    "tip_rotations": StepField(6, _Proto.TYPE_DOUBLE, (2,)),
    "lead": StepField(7, _Proto.TYPE_DOUBLE),
    "feeder_forces": StepField(8, _Proto.TYPE_DOUBLE, (2,)),
    "hub_torques": StepField(9, _Proto.TYPE_DOUBLE, (2,)),
}


def _build_message(name: str, fields: dict[str, StepField], *, extra: bool) -> Any:
    """Build the class of a message from its field table, maybe with a map of extra scalars, without protoc."""
    file = descriptor_pb2.FileDescriptorProto(name=f"endonav/{name.lower()}.proto", package="endonav", syntax="proto3")
    message = file.message_type.add(name=name)
    for field_name, field in fields.items():
        label = _Proto.LABEL_REPEATED if field.shape else _Proto.LABEL_OPTIONAL
        message.field.add(name=field_name, number=field.number, type=field.type, label=label)
    if extra:
        entry = message.nested_type.add(name="ExtraEntry")
        entry.field.add(name="key", number=1, type=_Proto.TYPE_STRING, label=_Proto.LABEL_OPTIONAL)
        entry.field.add(name="value", number=2, type=_Proto.TYPE_DOUBLE, label=_Proto.LABEL_OPTIONAL)
        entry.options.map_entry = True
        message.field.add(
            name="extra",
            number=EXTRA_FIELD_NUMBER,
            type=_Proto.TYPE_MESSAGE,
            type_name=f".endonav.{name}.ExtraEntry",
            label=_Proto.LABEL_REPEATED,
        )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"endonav.{name}"))


Step: Any = _build_message("Step", STEP_FIELDS, extra=True)
"""The protobuf class of the message on `/step`."""

Devices: Any = _build_message("Devices", DEVICE_FIELDS, extra=False)
"""The protobuf class of the message on `/devices`."""


def camera_topic(name: str, stream: str) -> str:
    """Name the topic of a stream ("calibration", "image", "mask", …) of a camera, e.g. `/camera/frontal/image`."""
    return f"/camera/{name}/{stream}"


def topic_messages(cameras: tuple[str, ...], *, devices: bool = False) -> dict[str, Any]:
    """List a log's topics, those of devices if there is a catheter, with their classes, in order of channels."""
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
    if devices:
        topics |= {DEVICES_TOPIC: Devices, CATHETER_TOPIC: SceneUpdate, CATHETER_POINTS_TOPIC: PointCloud}
        topics |= {camera_topic(name, stream): CompressedImage for name in cameras for stream in DEVICE_MASKS}
    return topics
