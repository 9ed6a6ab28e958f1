"""Logs in which something is not as a writer would have it, behind right checksums, by the mcap library."""

import io
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from mcap.writer import Writer
from PIL import Image

from pipeline.episodes.encoding.schema import Step
from pipeline.episodes.records import _checksum

IMAGE, MASK, SIDE = "/camera/frontal/image", "/camera/frontal/mask", "/camera/side/image"
Message = tuple[str, int, bytes]  # topic, log time, payload
VARINT, FIXED64, DELIMITED = 0, 1, 2  # wire types of protobuf


def varint(value: int) -> bytes:
    """A number above 0 as protobuf writes it."""
    return bytes(Step(step=value).SerializeToString()[1:])


def tag(number: int, wire_type: int) -> bytes:
    """What stands before a field whose number is below 16."""
    return bytes((number << 3 | wire_type,))


def delimited(number: int, payload: bytes) -> bytes:
    """A field of text, bytes, or a message."""
    return tag(number, DELIMITED) + varint(len(payload)) + payload


def sealed(text: str, schema_version: str = "1") -> dict[str, str]:
    """A metadata record with a right checksum, whatever it says."""
    return {"schema_version": schema_version, "json": text, "crc32": _checksum(schema_version, text)}


class Content:
    """All that a log holds, to be changed and written again by the mcap library."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            self.metadata = [(one.name, dict(one.metadata)) for one in reader.iter_metadata()]
            summary = reader.get_summary()
            schemas = {one.id: (one.name, one.encoding, one.data) for one in summary.schemas.values()}
            self.channels = [(one.topic, schemas[one.schema_id]) for one in summary.channels.values()]
            found = reader.iter_messages()
            self.messages: list[Message] = [(channel.topic, one.log_time, one.data) for _, channel, one in found]
        self.attachments: list[tuple[str, bytes]] = []

    def write(self, path: Path, chunk_size: int = 4096) -> Path:
        """Write all as it stands, in this order."""
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=chunk_size, enable_data_crcs=True)
            writer.start("endonav")
            for name, values in self.metadata:
                writer.add_metadata(name, values)
            ids = {}
            for topic, schema in self.channels:
                ids[topic] = writer.register_channel(topic, "protobuf", writer.register_schema(*schema))
            for topic, time_ns, payload in self.messages:
                writer.add_message(ids[topic], time_ns, payload, time_ns)
            for name, data in self.attachments:
                writer.add_attachment(0, 0, name, "text/plain", data)
            writer.finish()
        return path

    def payloads(self, topic: str) -> list[bytes]:
        """The payloads of a topic."""
        return [payload for one, _, payload in self.messages if one == topic]

    def put(self, topic: str, payloads: list[bytes]) -> None:
        """Exchange the payloads of a topic; the times stay."""
        rest = iter(payloads)
        self.messages = [(t, time_ns, next(rest) if t == topic else data) for t, time_ns, data in self.messages]

    def alter(self, topic: str, kind: Any, change: Callable[[Any], None], which: int = 5) -> None:
        """Change one message of a topic."""
        payloads = self.payloads(topic)
        message = kind.FromString(payloads[which])
        change(message)
        payloads[which] = message.SerializeToString()
        self.put(topic, payloads)

    def alter_text(self, name: str, change: Callable[[str], str], schema_version: str = "1") -> None:
        """Change the text of all metadata records of a name, with a right checksum."""
        for number, (one, values) in enumerate(self.metadata):
            if one == name:
                self.metadata[number] = (one, sealed(change(json.dumps(json.loads(values["json"]))), schema_version))

    def alter_json(self, name: str, change: Callable[[dict[str, Any]], None]) -> None:
        """Change what all metadata records of a name say."""

        def changed(text: str) -> str:
            content = json.loads(text)
            change(content)
            return json.dumps(content)

        self.alter_text(name, changed)

    def repeat_otherwise(self, name: str, **changed: Any) -> None:
        """Add a metadata record of a name that says something else."""
        kept, self.metadata = self.metadata, [one for one in self.metadata if one[0] == name][:1]
        self.alter_json(name, lambda v: v.update(changed) if changed else v["info"].update(seed=1))
        self.metadata = [*kept, *self.metadata]

    def drop(self, topic: str, which: Callable[[int], bool]) -> None:
        """Leave out the messages of a topic at some places."""
        kept, number = [], 0
        for message in self.messages:
            if message[0] == topic:
                number += 1
            if message[0] != topic or not which(number - 1):
                kept.append(message)
        self.messages = kept


def png(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(array).save(stream, "PNG")
    return stream.getvalue()


def pixels(content: Content, make: Callable[[bytes], bytes], topic: str = IMAGE) -> None:
    def change(message: Any) -> None:
        message.data = make(message.data)

    content.alter(topic, CompressedImage, change)


def interlaced(data: bytes) -> bytes:
    head = bytearray(data[:33])
    head[28] = 1
    head[29:33] = struct.pack(">I", zlib.crc32(head[12:29]))
    return bytes(head) + data[33:]


def swap(content: Content, one: str, other: str) -> None:
    first, second = content.payloads(one), content.payloads(other)
    content.put(one, second)
    content.put(other, first)


def shift(content: Content, topic: str, by: int, which: int = 5) -> None:
    number = [place for place, message in enumerate(content.messages) if message[0] == topic][which]
    topic, time_ns, payload = content.messages[number]
    content.messages[number] = (topic, time_ns + by, payload)


def exchanged_schema(content: Content) -> None:
    schemas = dict(content.channels)
    content.channels = [(topic, schemas["/wire"] if topic == "/step" else schema) for topic, schema in content.channels]


FIRST = "endonav.episode"
LAST = "endonav.outcome"
Forge = Callable[[Content], Any]


def text(name: str, change: Callable[[str], str], schema_version: str = "1") -> Forge:
    return lambda content: content.alter_text(name, change, schema_version)


def info(**changed: Any) -> Forge:
    return lambda content: content.alter_json(FIRST, lambda value: value["info"].update(changed))


def camera(**changed: Any) -> Forge:
    return lambda content: content.alter_json(FIRST, lambda value: value["cameras"][0].update(changed))


def outcome(**changed: Any) -> Forge:
    return lambda content: content.alter_json(LAST, lambda value: value.update(changed))


FORGED: dict[str, Forge] = {
    "pictures reversed": lambda c: c.put(IMAGE, c.payloads(IMAGE)[::-1]),
    "cameras exchanged": lambda c: swap(c, IMAGE, SIDE),
    "images and masks exchanged": lambda c: swap(c, IMAGE, MASK),
    "a picture 1 ns late": lambda c: shift(c, IMAGE, 1),
    "a step 1 ns late": lambda c: shift(c, "/step", 1),
    "a wire 1 ns late": lambda c: shift(c, "/wire", 1),
    "all 1 ns late": lambda c: setattr(c, "messages", [(topic, time + 1, data) for topic, time, data in c.messages]),
    "two cameras of a name": lambda c: c.alter_json(FIRST, lambda v: v["cameras"][1].update(name="frontal")),
    "a camera's name is a path": camera(name="../../x"),
    "a camera of other fields": camera(focus=1),
    "width true": camera(width=True),
    "success yes": outcome(success="yes"),
    "seed a text": info(seed="17"),
    "versions of numbers": info(versions={"numpy": 2}),
    "12 steps, 9 records": lambda c: c.drop("/step", lambda n: n > 8),
    "12 steps, 9 pictures": lambda c: c.drop(IMAGE, lambda n: n > 8),
    "a record in the middle is missing": lambda c: c.drop("/step", lambda n: n == 5),
    "steps behind the end": outcome(steps=8),
    "a step twice": lambda c: c.messages.append([m for m in c.messages if m[0] == "/step"][5]),
    "two phantoms": lambda c: c.messages.append(("/phantom", c.messages[-1][1], c.payloads("/phantom")[0])),
    "records exchanged": lambda c: c.put("/step", c.payloads("/step")[::-1]),
    "half a picture": lambda c: pixels(c, lambda data: data[: len(data) // 2]),
    "a picture and more": lambda c: pixels(c, lambda data: data + data),
    "16-bit picture": lambda c: pixels(c, lambda _: png(np.full((20, 33), 999, np.uint16))),
    "colour picture": lambda c: pixels(c, lambda _: png(np.full((20, 33, 3), 9, np.uint8))),
    "interlaced picture": lambda c: pixels(c, interlaced),
    "compressed picture": lambda c: pixels(c, lambda _: png(np.full((20, 33), 9, np.uint8))),
    "grey mask": lambda c: pixels(c, lambda _: png(np.full((20, 33), 9, np.uint8)), MASK),
    "picture said to be a JPEG": lambda c: c.alter(IMAGE, CompressedImage, lambda m: setattr(m, "format", "jpeg")),
    "steps of another schema": exchanged_schema,
    "NaN": lambda c: c.alter("/step", Step, lambda m: setattr(m, "reward", float("nan"))),
    "actions of another width": lambda c: c.alter("/step", Step, lambda m: m.action.append(1.0)),
    "another force norm": lambda c: c.alter("/step", Step, lambda m: setattr(m, "resultant_force_norm", 7.0)),
    "an attachment": lambda c: c.attachments.append(("letter", b"text")),
    "two outcomes": lambda c: c.repeat_otherwise(LAST, success=False),
    "two episodes": lambda c: c.repeat_otherwise(FIRST),
}  # fmt: skip
# What only viewers look at, or what is no number or field that arrays are made of: the check alone finds it.
FOUND_BY_CHECK_ALONE = {
    "a wire 1 ns late", "two phantoms", "NaN", "another force norm", "an attachment",
}  # fmt: skip


def big_picture() -> bytes:
    """A PNG header that declares more pixels than memory holds."""
    head = struct.pack(">IIBBBBB", 2**30, 2**30, 8, 0, 0, 0, 0)
    chunks = b""
    for kind, data in ((b"IHDR", head), (b"IDAT", zlib.compress(b"\0" * 100)), (b"IEND", b"")):
        chunks += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return b"\x89PNG\r\n\x1a\n" + chunks


ENTITIES = (b"phantom", b"target", b"entry")
DEEP = "[" * 100_000 + "]" * 100_000
LARGE: dict[str, Forge] = {
    "deep information": text(FIRST, lambda _: DEEP),
    "deep configuration": text(
        FIRST, lambda said: said.replace('"configuration": {', '"configuration": {"deep": ' + DEEP + ",")
    ),
    "deep outcome": text(LAST, lambda _: DEEP),
    "no JSON": text(FIRST, lambda _: "{"),
    "not a number": text(LAST, lambda t: json.dumps({**json.loads(t), "metrics": {"a": 1}}).replace("1}", "NaN}")),
    "half a surrogate pair": text(FIRST, lambda said: said.replace("type_1", r"\ud800")),
    "steps 1e9": outcome(steps=10**9),
    "steps a text": outcome(steps="many"),
    "steps of 5000 digits": text(LAST, lambda said: said.replace('"steps": 11', '"steps": ' + "9" * 5000)),
    "missing steps repeated": outcome(missing_steps=[0] * 1000),
    "missing steps beyond": outcome(missing_steps=[2**62]),
    "start at 0": info(start_time_ns=0),
    "control step of a nanosecond": info(control_dt=1e-9),
    "control step of 400 digits": info(control_dt=10**400),
    "configuration a list": info(configuration=[1, 2]),
    "phantom a number": info(phantom=5),
    "field unknown": info(colour="red"),
    "information a list": text(FIRST, lambda _: "[]"),
    "information nothing": text(FIRST, lambda _: "{}"),
    "cameras a number": lambda c: c.alter_json(FIRST, lambda v: v.update(cameras=5)),
    "camera's name a list": camera(name=[1]),
    "camera wide": camera(width=10**12),
    "camera ragged": camera(K=[[1, 2], [3]]),
    "camera of 400 digits": camera(t=[10**400, 0, 0]),
    "version 2": text(FIRST, str, "2"),
    "version in words": text(FIRST, str, "one"),
    "step index of 2^63": lambda c: c.put(
        "/step", [tag(1, VARINT) + varint(2**63) + payload[2:] for payload in c.payloads("/step")]
    ),
    "step index a double": lambda c: c.put("/step", [tag(1, FIXED64) + struct.pack("<d", np.inf)] * 12),
    "phantom without triangles": lambda c: c.put(
        "/phantom", [b"".join(delimited(2, delimited(3, name)) for name in ENTITIES)]
    ),
    "phantom no message": lambda c: c.put("/phantom", [b"\xff\xff\xff"]),
    "picture huge": lambda c: c.put(IMAGE, [delimited(2, big_picture())] * 12),
    "picture of another size": lambda c: c.put(MASK, [delimited(2, png(np.zeros((2, 3), np.uint8)))] * 12),
    "no picture": lambda c: c.put(IMAGE, [b""] * 12),
}  # fmt: skip
# What only a use of all the arrays, or a check, finds: the rest is refused on opening.
FOUND_LATER = {
    "step index of 2^63", "step index a double", "phantom without triangles", "phantom no message", "picture huge",
    "picture of another size", "no picture",
}  # fmt: skip
