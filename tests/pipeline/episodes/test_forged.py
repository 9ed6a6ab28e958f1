"""Logs of other programs: in any order they read alike; wrong content is one sentence, at once and in little memory."""

import os
import resource
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from pipeline.episodes import EpisodeReader, EpisodeReadError, EpisodeWriter
from pipeline.episodes.__main__ import main
from pipeline.episodes.checking import check
from pipeline.episodes.encoding.scan import open_chunk
from pipeline.episodes.encoding.step_codec import decode_step
from pipeline.episodes.records import ContainerError, _checksum, open_episode, open_outcome
from pipeline.episodes.recovery import recover
from tests.pipeline.episodes.forged_logs import (
    FIXED64,
    FORGED,
    FOUND_BY_CHECK_ALONE,
    FOUND_LATER,
    LARGE,
    VARINT,
    Content,
    tag,
    varint,
)


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


@pytest.mark.parametrize(
    ("order", "chunk_size"), [("as written", 1), ("reversed", 2000), ("drawn", 1), ("drawn", 10**6), ("by topic", 2000)]
)
def test_arrays_go_by_time_whatever_the_order_in_the_file(order, chunk_size, two_views: Path, tmp_path: Path) -> None:
    content = Content(two_views)
    if order == "reversed":
        content.messages.reverse()
        content.channels.reverse()  # which numbers them otherwise
    elif order == "drawn":
        places = np.random.default_rng(0).permutation(len(content.messages))
        content.messages = [content.messages[place] for place in places]
    elif order == "by topic":
        content.messages.sort(key=lambda message: message[0])
    path = content.write(tmp_path / "other.mcap", chunk_size)
    recover(path, tmp_path / "saved.mcap")
    for log in (path, tmp_path / "saved.mcap"):
        assert check(log).problems == []
        with EpisodeReader(two_views) as one, EpisodeReader(log) as other:
            assert len(other) == 12
            wanted, found = one.load_arrays(), other.load_arrays()
            assert wanted.keys() == found.keys()
            for key in wanted:
                np.testing.assert_array_equal(wanted[key], found[key])
            np.testing.assert_array_equal(one.image("side", 7), other.image("side", 7))


USES = """
import re, sys, time
from pipeline.episodes import EpisodeReader
from pipeline.episodes.__main__ import main

def load(path):
    try:
        EpisodeReader(path).load_arrays()
    except ValueError:
        return 1

for command in ("load", "info", "check", "recover"):
    began = time.monotonic()
    status = load(sys.argv[1]) if command == "load" else main([command, sys.argv[1]])
    # not getrusage's peak, in which that of the parent counts
    peak = re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]
    print("used", status, int(peak) / 1024, time.monotonic() - began)
"""


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
    done = subprocess.run([sys.executable, "-c", USES, str(path)], capture_output=True, text=True, check=True)
    uses = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("used")]
    assert len(uses) == 4
    for status, peak_mb, seconds in uses:
        assert status == "1"
        assert float(peak_mb) < 350
        assert float(seconds) < 10
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
        for use in (EpisodeReader, lambda path: recover(path, tmp_path / "x.mcap")):
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


SECONDS = 2.0  # generous beside the hundredth of a second that a refusal takes, for machines that are busy
MEGABYTES = 400


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


@pytest.mark.parametrize("name", list(LARGE))
def test_a_forged_log_is_one_sentence(name, two_views, tmp_path, capsys, bounded) -> None:
    content = Content(two_views)
    LARGE[name](content)
    path = content.write(tmp_path / "forged.mcap")
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
            assert 0 < len(log) <= 12
    assert time.monotonic() - began < SECONDS


def test_a_compressed_bomb_is_refused_by_what_it_declares(bounded) -> None:
    """The frame says 1 GiB in 33 KB; the chunk says as much as is allowed."""
    compressor = zstandard.ZstdCompressor().compressobj(size=2**30)
    block = b"\0" * 2**24
    bomb = b"".join(compressor.compress(block) for _ in range(2**6)) + compressor.flush()
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


def test_metadata_without_json_is_refused() -> None:
    for opened in (open_episode, open_outcome):
        with pytest.raises(ContainerError):
            opened({"schema_version": "1", "crc32": _checksum("1", "")})


def test_a_step_whose_kinds_are_wrong_is_refused() -> None:
    for message in (
        tag(1, FIXED64) + struct.pack("<d", np.nan),
        tag(3, VARINT) + varint(7),
        tag(9, VARINT) + varint(7),
    ):
        with pytest.raises(ValueError, match="wire type"):
            decode_step(message)


def test_command_lines_refuse_odd_paths(tmp_path, capsys, log_path) -> None:
    (tmp_path / "file").touch()
    odd = ["a" * 300, str(tmp_path), str(tmp_path / "file" / "below"), "/proc/self/mem", "/dev/null", "/dev/zero"]
    for path in odd:
        for command in ("info", "check", "recover"):
            assert main([command, path]) in (1, 2)
            assert len(capsys.readouterr().err.strip().splitlines()) == 1
    for destination in (tmp_path, tmp_path / "file" / "below", Path("a" * 300), Path("/proc/none/x.mcap")):
        assert main(["recover", str(log_path), str(destination)]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
