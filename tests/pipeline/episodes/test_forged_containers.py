"""Logs written with the mcap library: in any order they read alike, and forged ones pass no check."""

from __future__ import annotations

import io
import json
import os
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from mcap.reader import make_reader
from mcap.writer import Writer
from PIL import Image

from pipeline.episodes import EpisodeReader, EpisodeReadError, EpisodeWriter
from pipeline.episodes.__main__ import main
from pipeline.episodes.checking import check
from pipeline.episodes.encoding.schema import Step
from pipeline.episodes.records import _checksum
from pipeline.episodes.recovery import annotate, read_annotation, recover

IMAGE, MASK, SIDE = "/camera/frontal/image", "/camera/frontal/mask", "/camera/side/image"
Message = tuple[str, int, bytes]  # topic, log time, payload


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

    def alter_json(self, name: str, change: Callable[[dict[str, Any]], None]) -> None:
        """Change what all metadata records of a name say, with a right checksum."""
        for number, (one, values) in enumerate(self.metadata):
            if one == name:
                content = json.loads(values["json"])
                change(content)
                text = json.dumps(content)
                self.metadata[number] = (one, {**values, "json": text, "crc32": _checksum("1", text)})

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


def png(array: np.ndarray, mode: str | None = None, **options: Any) -> bytes:
    stream = io.BytesIO()
    picture = Image.fromarray(array)
    (picture.convert(mode) if mode else picture).save(stream, "PNG", **options)
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


def moved_matrix(content: Content) -> None:
    def change(message: Any) -> None:
        message.K[0] += 1

    content.alter("/camera/frontal/calibration", CameraCalibration, change, 0)


def moved_camera(content: Content) -> None:
    def change(message: Any) -> None:
        message.transforms[0].translation.x += 0.1

    content.alter("/tf", FrameTransforms, change, 0)


def moved_cloud(content: Content) -> None:
    def change(message: Any) -> None:
        message.data = message.data[::-1]

    content.alter("/wire/points", PointCloud, change)


def exchanged_schema(content: Content) -> None:
    schemas = dict(content.channels)
    content.channels = [(topic, schemas["/wire"] if topic == "/step" else schema) for topic, schema in content.channels]


def two_cameras_of_a_name(value: dict[str, Any]) -> None:
    value["cameras"][1]["name"] = "frontal"


FIRST = "endonav.episode"
LAST = "endonav.outcome"
FORGED: dict[str, Callable[[Content], Any]] = {
    "pictures reversed": lambda c: c.put(IMAGE, c.payloads(IMAGE)[::-1]),
    "two pictures exchanged": lambda c: c.put(IMAGE, [*c.payloads(IMAGE)[1::-1], *c.payloads(IMAGE)[2:]]),
    "cameras exchanged": lambda c: swap(c, IMAGE, SIDE),
    "images and masks exchanged": lambda c: swap(c, IMAGE, MASK),
    "a picture 1 ns late": lambda c: shift(c, IMAGE, 1),
    "a picture 1 ns early": lambda c: shift(c, IMAGE, -1),
    "a step 1 ns late": lambda c: shift(c, "/step", 1),
    "a wire 1 ns late": lambda c: shift(c, "/wire", 1),
    "all 1 ns late": lambda c: setattr(c, "messages", [(topic, time + 1, data) for topic, time, data in c.messages]),
    "two cameras of a name": lambda c: c.alter_json(FIRST, two_cameras_of_a_name),
    "a camera's name is a path": lambda c: c.alter_json(FIRST, lambda v: v["cameras"][0].update(name="../../x")),
    "a camera of other fields": lambda c: c.alter_json(FIRST, lambda v: v["cameras"][0].update(focus=1)),
    "width true": lambda c: c.alter_json(FIRST, lambda v: v["cameras"][0].update(width=True)),
    "success yes": lambda c: c.alter_json(LAST, lambda v: v.update(success="yes")),
    "success 1": lambda c: c.alter_json(LAST, lambda v: v.update(success=1)),
    "steps a text": lambda c: c.alter_json(LAST, lambda v: v.update(steps="11")),
    "seed a text": lambda c: c.alter_json(FIRST, lambda v: v["info"].update(seed="17")),
    "control step a text": lambda c: c.alter_json(FIRST, lambda v: v["info"].update(control_dt="0.1")),
    "versions of numbers": lambda c: c.alter_json(FIRST, lambda v: v["info"].update(versions={"numpy": 2})),
    "12 steps, 9 records": lambda c: c.drop("/step", lambda n: n > 8),
    "12 steps, 9 pictures": lambda c: c.drop(IMAGE, lambda n: n > 8),
    "a record in the middle is missing": lambda c: c.drop("/step", lambda n: n == 5),
    "9 wires": lambda c: c.drop("/wire", lambda n: n > 8),
    "steps behind the end": lambda c: c.alter_json(LAST, lambda v: v.update(steps=8)),
    "a step twice": lambda c: c.messages.append([m for m in c.messages if m[0] == "/step"][5]),
    "a picture twice": lambda c: c.messages.append([m for m in c.messages if m[0] == IMAGE][-1]),
    "two phantoms": lambda c: c.messages.append(("/phantom", c.messages[-1][1], c.payloads("/phantom")[0])),
    "records exchanged": lambda c: c.put("/step", c.payloads("/step")[::-1]),
    "half a picture": lambda c: pixels(c, lambda data: data[: len(data) // 2]),
    "a picture and more": lambda c: pixels(c, lambda data: data + data),
    "16-bit picture": lambda c: pixels(c, lambda _: png(np.full((20, 33), 999, np.uint16))),
    "colour picture": lambda c: pixels(c, lambda _: png(np.full((20, 33, 3), 9, np.uint8))),
    "palette picture": lambda c: pixels(c, lambda _: png(np.full((20, 33), 9, np.uint8), "P")),
    "picture with alpha": lambda c: pixels(c, lambda _: png(np.full((20, 33, 4), 9, np.uint8))),
    "interlaced picture": lambda c: pixels(c, interlaced),
    "compressed picture": lambda c: pixels(c, lambda _: png(np.full((20, 33), 9, np.uint8))),
    "grey mask": lambda c: pixels(c, lambda _: png(np.full((20, 33), 9, np.uint8)), MASK),
    "picture of another size": lambda c: pixels(c, lambda _: png(np.full((33, 20), 9, np.uint8))),
    "picture said to be a JPEG": lambda c: c.alter(IMAGE, CompressedImage, lambda m: setattr(m, "format", "jpeg")),
    "steps of another schema": exchanged_schema,
    "another calibration": moved_matrix,
    "another pose": moved_camera,
    "another cloud": moved_cloud,
    "wires exchanged": lambda c: c.put("/wire", c.payloads("/wire")[::-1]),
    "NaN": lambda c: c.alter("/step", Step, lambda m: setattr(m, "reward", float("nan"))),
    "actions of another width": lambda c: c.alter("/step", Step, lambda m: m.action.append(1.0)),
    "another force norm": lambda c: c.alter("/step", Step, lambda m: setattr(m, "resultant_force_norm", 7.0)),
    "an attachment": lambda c: c.attachments.append(("letter", b"text")),
    "two outcomes": lambda c: c.repeat_otherwise(LAST, success=False),
    "two episodes": lambda c: c.repeat_otherwise(FIRST),
}  # fmt: skip
# What only viewers look at, or what is no number or field that arrays are made of: the check alone finds it.
FOUND_BY_CHECK_ALONE = {
    "a wire 1 ns late", "9 wires", "two phantoms", "another calibration", "another pose", "another cloud",
    "wires exchanged", "NaN", "another force norm", "an attachment",
}  # fmt: skip


@pytest.fixture
def two_views(make_episode, tmp_path: Path) -> Path:
    """A log of 12 records and two cameras."""
    episode, path = make_episode(12), tmp_path / "episode.mcap"
    cameras = {"frontal": episode.cameras["frontal"], "side": episode.cameras["frontal"]}
    with EpisodeWriter(path, episode.info, cameras=cameras, phantom_mesh=episode.mesh) as log:
        for record, image, mask in zip(episode.records, episode.images, episode.masks, strict=True):
            images = {"frontal": image, "side": image[::-1].copy()}
            log.step(record, images=images, masks={"frontal": mask, "side": mask})
        log.finish(episode.outcome)
    return path


@pytest.mark.parametrize("name", list(FORGED))
def test_no_forged_log_passes_the_check(name: str, two_views: Path, tmp_path: Path) -> None:
    content = Content(two_views)
    FORGED[name](content)
    path = content.write(tmp_path / "forged.mcap")
    problems = check(path).problems
    assert problems
    assert all("\n" not in problem for problem in problems)
    if name in FOUND_BY_CHECK_ALONE:
        return
    with pytest.raises(EpisodeReadError), EpisodeReader(path) as log:
        log.load_arrays()


@pytest.mark.parametrize("chunk_size", [1, 2000, 10**6])
@pytest.mark.parametrize("order", ["as written", "reversed", "drawn", "by topic"])
def test_arrays_go_by_time_whatever_the_order_in_the_file(order, chunk_size, two_views: Path, tmp_path: Path) -> None:
    content = Content(two_views)
    if order == "reversed":
        content.messages.reverse()
    elif order == "drawn":
        places = np.random.default_rng(0).permutation(len(content.messages))
        content.messages = [content.messages[place] for place in places]
    elif order == "by topic":
        content.messages.sort(key=lambda message: message[0])
    path = content.write(tmp_path / "other.mcap", chunk_size)
    assert check(path).problems == []
    with EpisodeReader(two_views) as one, EpisodeReader(path) as other:
        assert len(other) == 12
        wanted, found = one.load_arrays(), other.load_arrays()
        assert wanted.keys() == found.keys()
        for key in wanted:
            np.testing.assert_array_equal(wanted[key], found[key])
        np.testing.assert_array_equal(one.image("side", 7), other.image("side", 7))
    recover(path, tmp_path / "saved.mcap")
    assert check(tmp_path / "saved.mcap").problems == []


def peak_mb(path: Path, command: str) -> tuple[float, float, int]:
    """Peak memory in MB, seconds, and exit code of a command on a log in a process of its own."""
    code = (
        "import re, sys\nfrom pipeline.episodes import EpisodeReader\n"
        "from pipeline.episodes.__main__ import main\n"
        "def load(path):\n    EpisodeReader(path).load_arrays()\n    return 0\n"
        "try:\n    code = load(sys.argv[2]) if sys.argv[1] == 'load' else main(sys.argv[1:])\n"
        "except ValueError as error:\n    code = 1\n"
        # not getrusage's peak, in which that of the parent counts
        "print('peak', re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1], code)"
    )
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code, command, str(path)], capture_output=True, text=True, check=True)
    _, peak, status = done.stdout.splitlines()[-1].split()
    return int(peak) / 1024, time.monotonic() - began, int(status)


def black(side: int, path: Path, records: int, make_episode: Any) -> Path:
    """A log of black pictures, which take next to nothing in it."""
    from dataclasses import replace

    episode = make_episode(1)
    camera = replace(episode.cameras["frontal"], width=side, height=side)
    image = np.zeros((side, side), np.uint8)
    with EpisodeWriter(path, episode.info, cameras={"frontal": camera}, flush_every=1) as log:
        for step in range(records):
            log.step(replace(episode.records[0], step=step), images={"frontal": image})
    return path


def test_a_log_takes_no_more_memory_than_its_size_allows(make_episode, tmp_path: Path) -> None:
    """28 black pictures of 4,096 x 4,096 px: 470 MB in 0.1 MB."""
    path = black(4096, tmp_path / "bomb.mcap", 28, make_episode)
    assert path.stat().st_size < 200_000
    for command in ("load", "info", "check", "recover"):
        peak, seconds, status = peak_mb(path, command)
        assert status == 1
        assert peak < 350
        assert seconds < 10
    with pytest.raises(EpisodeReadError, match=r"it unpacks to 0\.5 GB, \d+ times its size"):
        EpisodeReader(path)


def test_black_pictures_of_usual_size_are_read(make_episode, tmp_path: Path) -> None:
    path = black(1024, tmp_path / "black.mcap", 60, make_episode)
    with EpisodeReader(path) as log:
        assert log.load_arrays()["image/frontal"].shape == (60, 1024, 1024)
    assert check(path).problems == []


def damaged_bombs(count: int) -> bytes:
    """Chunks of 2 kB that unpack to 64 MB each, their checksums wrong."""
    packed = zstandard.ZstdCompressor().compress(bytes(1 << 26))
    head = struct.pack("<QQQII4sQ", 0, 0, 1 << 26, 1, 4, b"zstd", len(packed))
    return (struct.pack("<BQ", 6, len(head) + len(packed)) + head + packed) * count


def overlapping_heads(count: int) -> bytes:
    """Heads of chunks that each reach to the end of all of them."""
    return b"".join(
        struct.pack("<BQQQQII4sQ", 6, 49 * left - 9, 0, 0, 1 << 20, 1, 4, b"zstd", 49 * left - 49)
        for left in range(count, 0, -1)
    )


@pytest.mark.parametrize("forged", [damaged_bombs(150), overlapping_heads(12_000), b"\x04\0\0\0zstd" * 76_000])
def test_recovery_takes_time_in_proportion_to_the_file(forged: bytes, log_path: Path, tmp_path: Path) -> None:
    whole = log_path.read_bytes()
    with EpisodeReader(log_path) as log:
        last = log.summary.chunk_indexes[-1]
        place = last.chunk_start_offset + last.chunk_length
    victim = tmp_path / "victim.mcap"
    victim.write_bytes(whole[:place] + forged + whole[place:])
    began = time.monotonic()
    assert recover(victim, tmp_path / "saved.mcap").steps_kept == 23
    assert time.monotonic() - began < 4


def test_a_log_is_a_regular_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    for path in (tmp_path / "pipe.mcap", tmp_path, Path("/dev/zero"), tmp_path / "a\0b"):
        for use in (EpisodeReader, lambda path: recover(path, tmp_path / "x.mcap"), lambda p: read_annotation(p, "a"),
                    lambda path: annotate(path, "a", {})):  # fmt: skip
            with pytest.raises(EpisodeReadError, match="cannot open") as refused:
                use(path)
            assert "\n" not in str(refused.value)
        assert "cannot open" in check(path).problems[0]


def test_no_text_of_a_log_reaches_the_terminal_as_a_command(make_episode, tmp_path: Path, capsys) -> None:
    from dataclasses import replace

    nasty = "a\x1b]0;owned\x07\x1b[2J\r\x9b31m\u202egpj\nphantom  type_1"
    episode = make_episode(3)
    episode.outcome = replace(episode.outcome, steps=2, metrics={nasty: nasty})
    configuration = {"catheter": None, nasty: nasty}
    texts = dict.fromkeys(("phantom", "phantom_hash", "target", "entry", "operator"), nasty)
    episode.info = replace(episode.info, **texts, configuration=configuration, versions={nasty: nasty})
    path = episode.write(tmp_path / "nasty.mcap")
    for command in ("info", "check", "recover", "info"):
        assert main([command, str(path)]) == 0
        out, err = capsys.readouterr()
        assert all(letter.isprintable() or letter == "\n" for letter in out + err)
        if command == "info":
            assert r"a\x1b]0;owned\x07\x1b[2J\r\x9b31m\u202egpj\nphantom  type_1" in out
            assert sum(line.strip().startswith("phantom") for line in out.splitlines()) == 1
