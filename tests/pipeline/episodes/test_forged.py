"""Logs whose checksums are all right and whose content is not: each is one sentence, at once and in little memory."""

from __future__ import annotations

import json
import resource
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from PIL import Image

from pipeline.episodes import EpisodeReader, EpisodeReadError
from pipeline.episodes.__main__ import main
from pipeline.episodes.checking import check
from pipeline.episodes.encoding.container import McapFile
from pipeline.episodes.encoding.scan import open_chunk
from pipeline.episodes.encoding.schema import topic_messages
from pipeline.episodes.encoding.step_codec import FIXED64, VARINT, decode_step, delimited, encode_step, tag, varint
from pipeline.episodes.records import ContainerError, _checksum, open_episode, open_outcome, seal_outcome
from pipeline.episodes.recovery import annotate, read_annotation
from pipeline.episodes.writer import schema_data

SECONDS = 2.0  # generous beside the hundredth of a second that a refusal takes, for machines that are busy
MEGABYTES = 400


def sealed(text: str, schema_version: str = "1") -> dict[str, str]:
    """A metadata record with a right checksum, whatever it says."""
    return {"schema_version": schema_version, "json": text, "crc32": _checksum(schema_version, text)}


class Forger:
    """Writes logs of an episode in which something is not as a writer would have it."""

    def __init__(self, episode: Any, path: Path) -> None:
        self.episode, self.path = episode, path
        self.info = {"info": episode.info.to_json(), "cameras": []}
        for name, camera in episode.cameras.items():
            self.info["cameras"].append({"name": name, **camera.to_json()})
        self.outcome = episode.outcome.to_json()

    def write(
        self,
        *,
        info: Any = None,
        outcome: Any = None,
        payloads: dict[str, list[bytes]] | None = None,
        schema_version: str = "1",
        times: Callable[[int], int] | None = None,
    ) -> Path:
        """Write a log; `info` and `outcome` are JSON texts or values, `payloads` replace those of a topic."""
        episode, times = self.episode, times or self.episode.info.time_ns
        texts = [
            value if isinstance(value, str) else json.dumps(value if value is not None else own)
            for value, own in ((info, self.info), (outcome, self.outcome))
        ]
        out = McapFile(self.path, "endonav")
        topics = topic_messages(tuple(episode.cameras))
        ids = {
            topic: out.register(topic, message.DESCRIPTOR.full_name, schema_data(message))
            for topic, message in topics.items()
        }
        out.add_metadata("endonav.episode", sealed(texts[0], schema_version))
        messages: dict[str, list[bytes]] = {
            "/step": [encode_step(record) for record in episode.records],
            "/phantom": [episode.mesh.scene(0)],
            **(payloads or {}),
        }
        for topic, contents in messages.items():
            for index, content in enumerate(contents):
                out.add(ids[topic], times(index), index, content)
        out.flush()
        out.add_metadata("endonav.outcome", sealed(texts[1]))
        out.close_with_index()
        return self.path

    def with_info(self, **changed: Any) -> Path:
        """A log with other information."""
        return self.write(info={**self.info, "info": {**self.info["info"], **changed}})

    def with_camera(self, **changed: Any) -> Path:
        """A log with another camera."""
        return self.write(info={**self.info, "cameras": [{**self.info["cameras"][0], **changed}]})

    def with_steps(self, change: Callable[[Any], Any]) -> Path:
        """A log in which the second half of the records is changed."""
        records = [change(one) if one.step > 10 else one for one in self.episode.records]
        return self.write(payloads={"/step": [encode_step(record) for record in records]})


def picture_message(data: bytes) -> bytes:
    """A CompressedImage that holds any bytes."""
    return delimited(2, data)


def big_picture() -> bytes:
    """A PNG header that declares more pixels than memory holds."""
    head = struct.pack(">IIBBBBB", 2**30, 2**30, 8, 0, 0, 0, 0)
    chunks = b""
    for kind, data in ((b"IHDR", head), (b"IDAT", zlib.compress(b"\0" * 100)), (b"IEND", b"")):
        chunks += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return b"\x89PNG\r\n\x1a\n" + chunks


def small_picture() -> bytes:
    """A picture of another size than the camera's."""
    import io

    stream = io.BytesIO()
    Image.new("L", (3, 2)).save(stream, "PNG")
    return stream.getvalue()


ENTITIES = (b"phantom", b"target", b"entry")
DEEP = "[" * 100_000 + "]" * 100_000
FORGERIES: dict[str, Callable[[Forger], Path]] = {
    "ragged actions": lambda f: f.with_steps(lambda one: replace(one, action=np.zeros(9))),
    "ragged joints": lambda f: f.with_steps(lambda one: replace(one, joint_positions=np.zeros(1))),
    "deep information": lambda f: f.write(info=DEEP),
    "deep configuration": lambda f: f.write(
        info=json.dumps(f.info).replace('"configuration": {', '"configuration": {"deep": ' + DEEP + ",")
    ),
    "deep outcome": lambda f: f.write(outcome=DEEP),
    "deep objects": lambda f: f.write(outcome='{"a":' * 50_000 + "1" + "}" * 50_000),
    "no JSON": lambda f: f.write(info="{"),
    "not a number": lambda f: f.write(outcome=json.dumps({**f.outcome, "metrics": {"a": 1}}).replace("1}", "NaN}")),
    "half a surrogate pair": lambda f: f.write(info=json.dumps(f.info).replace("type_1", r"\ud800")),
    "steps 1e9": lambda f: f.write(outcome={**f.outcome, "steps": 10**9}),
    "steps a float": lambda f: f.write(outcome={**f.outcome, "steps": 1e9}),
    "steps a text": lambda f: f.write(outcome={**f.outcome, "steps": "many"}),
    "steps of 5000 digits": lambda f: f.write(
        outcome=json.dumps(f.outcome).replace('"steps": 22', '"steps": ' + "9" * 5000)
    ),
    "missing steps repeated": lambda f: f.write(outcome={**f.outcome, "missing_steps": [0] * 1000}),
    "missing steps beyond": lambda f: f.write(outcome={**f.outcome, "missing_steps": [2**62]}),
    "start at 0": lambda f: f.with_info(start_time_ns=0),
    "start negative": lambda f: f.with_info(start_time_ns=-1),
    "start late": lambda f: f.with_info(start_time_ns=2**61),
    "start a text": lambda f: f.with_info(start_time_ns="yesterday"),
    "control step of a nanosecond": lambda f: f.with_info(control_dt=1e-9),
    "control step huge": lambda f: f.with_info(control_dt=10**300),
    "control step of 400 digits": lambda f: f.with_info(control_dt=10**400),
    "configuration a list": lambda f: f.with_info(configuration=[1, 2]),
    "versions a text": lambda f: f.with_info(versions="1"),
    "phantom a number": lambda f: f.with_info(phantom=5),
    "field unknown": lambda f: f.with_info(colour="red"),
    "information a list": lambda f: f.write(info=[]),
    "information nothing": lambda f: f.write(info="{}"),
    "cameras a number": lambda f: f.write(info={**f.info, "cameras": 5}),
    "camera without a name": lambda f: f.write(info={**f.info, "cameras": [{}]}),
    "camera's name a list": lambda f: f.with_camera(name=[1]),
    "camera wide": lambda f: f.with_camera(width=10**12),
    "camera's width a text": lambda f: f.with_camera(width="wide"),
    "camera ragged": lambda f: f.with_camera(K=[[1, 2], [3]]),
    "camera of 400 digits": lambda f: f.with_camera(t=[10**400, 0, 0]),
    "version 2": lambda f: f.write(schema_version="2"),
    "version of 5000 digits": lambda f: f.write(schema_version="9" * 5000),
    "version in words": lambda f: f.write(schema_version="one"),
    "version negative": lambda f: f.write(schema_version="-1"),
    "version 0": lambda f: f.write(schema_version="0"),
    "step index of 2^63": lambda f: f.write(
        payloads={"/step": [tag(1, VARINT) + varint(2**63) + encode_step(one)[2:] for one in f.episode.records]}
    ),
    "step index a double": lambda f: f.write(
        payloads={"/step": [tag(1, FIXED64) + struct.pack("<d", np.inf) for _ in f.episode.records]}
    ),
    "steps no messages": lambda f: f.write(payloads={"/step": [b"\xff" * 40 for _ in f.episode.records]}),
    "steps at odd times": lambda f: f.write(times=lambda index: 2**62 + index),
    "phantom without triangles": lambda f: f.write(
        payloads={"/phantom": [b"".join(delimited(2, delimited(3, name)) for name in ENTITIES)]}
    ),
    "phantom no message": lambda f: f.write(payloads={"/phantom": [b"\xff\xff\xff"]}),
    "picture huge": lambda f: f.write(payloads={"/camera/frontal/image": [picture_message(big_picture())] * 23}),
    "pictures of two sizes": lambda f: f.write(
        payloads={"/camera/frontal/mask": [picture_message(small_picture())] * 22 + [picture_message(big_picture())]}
    ),
    "no picture": lambda f: f.write(payloads={"/camera/frontal/image": [b""] * 23}),
}  # fmt: skip
# What only a use of all the arrays, or a check, finds: the rest is refused on opening.
FOUND_LATER = {
    "ragged actions", "ragged joints", "step index of 2^63", "step index a double", "steps no messages",
    "phantom without triangles", "phantom no message", "picture huge", "pictures of two sizes", "no picture",
}  # fmt: skip


@pytest.fixture
def bounded() -> Iterator[None]:
    """Fails a test that takes long, or much memory."""
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    yield
    assert time.monotonic() - start < 6 * SECONDS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEGABYTES * 1024


def use(path: Path) -> None:
    """Everything that a stage, the report or a replay reads."""
    with EpisodeReader(path) as log:
        assert len(log) >= 0
        log.load_arrays()
        log.phantom_mesh()


@pytest.mark.parametrize("name", list(FORGERIES))
def test_a_forged_log_is_one_sentence(name, episode, tmp_path, capsys, bounded) -> None:
    path = FORGERIES[name](Forger(episode, tmp_path / "forged.mcap"))
    began = time.monotonic()
    with pytest.raises(EpisodeReadError) as refused:
        use(path)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 600 + len(str(path)) * 2
    problems = check(path).problems
    assert problems
    assert all("\n" not in problem for problem in problems)
    assert main(["check", str(path)]) == 1
    assert main(["info", str(path)]) == (0 if name in FOUND_LATER and "phantom" not in name else 1)
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert main(["recover", str(path)]) in (0, 1)
    said = capsys.readouterr().err
    assert len(said.splitlines()) <= 1
    saved = path.with_name("forged.recovered.mcap")
    assert saved.is_file() == (said == "")
    if saved.is_file():
        with EpisodeReader(saved) as log:
            assert 0 < len(log) <= 23
    assert time.monotonic() - began < SECONDS


def test_a_compressed_bomb_is_refused_by_what_it_declares(bounded) -> None:
    """The frame says 4 GiB in 130 KB; the chunk says as much as is allowed."""
    compressor = zstandard.ZstdCompressor().compressobj(size=2**32)
    block = b"\0" * 2**24
    bomb = b"".join(compressor.compress(block) for _ in range(2**8)) + compressor.flush()
    for size in (100, 2**26, 2**32, 2**63):
        content = struct.pack("<QQQII4sQ", 0, 0, size, 0, 4, b"zstd", len(bomb)) + bomb
        began = time.monotonic()
        with pytest.raises(ContainerError, match="impossible size"):
            open_chunk(content, 0)
        assert time.monotonic() - began < SECONDS


@pytest.mark.parametrize("field", ["offset", "length"])
def test_an_index_that_points_beyond_the_file_is_refused(field, log_path, monkeypatch, bounded) -> None:
    from pipeline.episodes import reader

    original = reader.scan.read_summary

    def forged(fd: int) -> Any:
        summary = original(fd)
        for index in summary.metadata_indexes:
            setattr(index, field, 2**62)
        for index in summary.chunk_indexes:
            setattr(index, f"chunk_{'start_offset' if field == 'offset' else 'length'}", 2**62)
        return summary

    monkeypatch.setattr(reader.scan, "read_summary", forged)
    with pytest.raises(EpisodeReadError, match="is not where the index says"):
        EpisodeReader(log_path)


def test_annotations_of_forged_logs_are_refused(episode, log_path, tmp_path) -> None:
    annotate(log_path, "questionnaire", {"ease": 3})
    assert read_annotation(log_path, "questionnaire") == {"ease": 3}
    path = Forger(episode, tmp_path / "forged.mcap").write(info=DEEP)
    with pytest.raises(EpisodeReadError):
        annotate(path, "questionnaire", {"ease": 3})


def test_metadata_without_json_is_refused() -> None:
    for opened in (open_episode, open_outcome):
        with pytest.raises(ContainerError):
            opened({"schema_version": "1", "crc32": _checksum("1", "")})
    assert seal_outcome  # what a writer seals is opened: see the round trips


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_step_whose_kinds_are_wrong_is_refused(number) -> None:
    for message in (
        tag(1, FIXED64) + struct.pack("<d", np.nan),
        tag(3, VARINT) + varint(7),
        tag(9, VARINT) + varint(7),
    ):
        with pytest.raises(ValueError, match="wire type"):
            decode_step(message * number)


def test_command_lines_refuse_odd_paths(tmp_path, capsys, log_path) -> None:
    (tmp_path / "file").touch()
    odd = ["a" * 300, str(tmp_path), str(tmp_path / "file" / "below"), "/proc/self/mem", "/dev/null", "/dev/zero"]
    for path in odd:
        for command in ("info", "check", "recover"):
            assert main([command, path]) in (1, 2)
            said = capsys.readouterr().err.strip()
            assert said
            assert "\n" not in said
    for destination in (tmp_path, tmp_path / "file" / "below", Path("a" * 300), Path("/proc/none/x.mcap")):
        assert main(["recover", str(log_path), str(destination)]) == 2
        said = capsys.readouterr().err.strip()
        assert said
        assert "\n" not in said
