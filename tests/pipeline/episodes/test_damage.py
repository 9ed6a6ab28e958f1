"""Damaged logs: flipped bits, cut and foreign files are found out; a killed writer or a full disk loses one flush."""

import errno
import json
import multiprocessing
import os
import resource
import signal
import time
from dataclasses import replace

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader, EpisodeReadError, EpisodeWriteError, EpisodeWriter
from pipeline.episodes.checking import check
from pipeline.episodes.encoding.container import McapFile
from pipeline.episodes.records import seal_episode
from pipeline.episodes.recovery import recover
from tests.pipeline.episodes.forged_logs import sealed


def flip(data: bytes, offset: int, bit: int) -> bytes:
    changed = bytearray(data)
    changed[offset] ^= 1 << bit
    return bytes(changed)


def read_or_refuse(path):
    """Give the records of a log, or the sentence with which the reader refuses it."""
    try:
        with EpisodeReader(path) as log:
            return list(log), ""
    except EpisodeReadError as error:
        return [], str(error)


def assert_recovered(path, episode, assert_same, at_least: int) -> int:
    """A recovered log is fine and holds true steps only; return how many."""
    assert not check(path).problems
    with EpisodeReader(path) as log:
        kept = list(log)
        assert len(kept) == len(log) >= at_least
        assert log.info == episode.info
        for record in kept:
            assert_same(record, episode.records[record.step])
            np.testing.assert_array_equal(log.image("frontal", record.step), episode.images[record.step])
    return len(kept)


def test_a_file_of_another_kind_is_not_called_damaged(tmp_path):
    path = tmp_path / "notes.txt"
    for content, reason in ((b"", "it is empty"), (b"a" * 999, "it does not begin as an MCAP file")):
        path.write_bytes(content)
        said = read_or_refuse(path)[1]
        assert said.startswith(f"{path} cannot be read: {reason}, so it is no episode log; give the path of one")
    assert check(path).problems == [said]


def test_every_flipped_bit_is_found(log_path, episode, assert_same, tmp_path):
    data = log_path.read_bytes()
    rng = np.random.default_rng(5)
    ends = {*range(12), *range(len(data) - 120, len(data))}
    victim = tmp_path / "victim.mcap"
    for offset in sorted(ends | {int(offset) for offset in rng.integers(len(data), size=60)}):
        victim.write_bytes(flip(data, offset, int(rng.integers(8))))
        problems = check(victim).problems
        assert len(problems) == 1, offset
        assert str(victim) in problems[0]
        records, refusal = read_or_refuse(victim)
        if refusal:
            assert "recover" in refusal or "cannot be read" in refusal
            assert "\n" not in refusal
        else:  # the flip hit what a reader of steps does not use: then all it gives is true
            for found, given in zip(records, episode.records, strict=True):
                assert_same(found, given)


def test_recovery_of_one_flipped_bit_loses_one_flush_at_most(log_path, episode, assert_same, tmp_path):
    data = log_path.read_bytes()
    rng = np.random.default_rng(6)
    victim = tmp_path / "victim.mcap"
    for number, offset in enumerate(rng.integers(8, len(data), size=25)):
        victim.write_bytes(flip(data, int(offset), int(rng.integers(8))))
        saved = tmp_path / f"saved_{number}.mcap"
        report = recover(victim, saved)
        assert report.steps_kept == assert_recovered(saved, episode, assert_same, 23 - 5), offset
        assert report.steps_kept + len(report.missing_steps) == 23, offset


@pytest.mark.parametrize("fraction", [0.5, 0.8, 0.999])
def test_cut_file_is_found_and_recovered(log_path, episode, assert_same, tmp_path, fraction):
    data = log_path.read_bytes()
    victim, saved = tmp_path / "victim.mcap", tmp_path / "saved.mcap"
    length = int(fraction * len(data))
    victim.write_bytes(data[:length])
    with EpisodeReader(log_path) as log:  # chunk 0 holds what stands once, then come five steps a chunk
        whole = sum(chunk.chunk_start_offset + chunk.chunk_length <= length for chunk in log.summary.chunk_indexes)
    with pytest.raises(EpisodeReadError, match=r"no index at its end"):
        EpisodeReader(victim)
    assert len(check(victim).problems) == 1
    report = recover(victim, saved)
    assert report.steps_kept == min(23, 5 * (whole - 1))
    assert_recovered(saved, episode, assert_same, 1)
    with EpisodeReader(saved) as log:
        assert log.outcome.status == ("finished" if report.outcome_kept else "interrupted")


def test_lost_steps_are_named(log_path, tmp_path):
    with EpisodeReader(log_path) as log:
        chunk = log.summary.chunk_indexes[2]  # chunk 0 holds what stands once, chunk 2 steps 5 to 9
    data = flip(log_path.read_bytes(), chunk.chunk_start_offset + chunk.chunk_length // 2, 3)
    victim, saved = tmp_path / "victim.mcap", tmp_path / "saved.mcap"
    victim.write_bytes(data)
    with EpisodeReader(victim) as log:  # steps before and behind it can still be read
        assert (log.step(4).step, log.step(10).step) == (4, 10)
        with pytest.raises(EpisodeReadError, match=r"checksum|decompressed"):
            log.step(7)
    report = recover(victim, saved)
    assert report.missing_steps == (5, 6, 7, 8, 9)
    assert report.outcome_kept
    with EpisodeReader(saved) as log:
        assert len(log) == 18
        np.testing.assert_array_equal(log.load_arrays()["step"], [*range(5), *range(10, 23)])
        with pytest.raises(EpisodeReadError, match=r"step 7 of .* was lost before the log was recovered"):
            log.step(7)
    assert check(saved).notes == ["5 steps were lost before recovery"]


def test_one_damaged_copy_of_the_information_does_no_harm(log_path, episode):
    data = log_path.read_bytes()
    victim = log_path.with_name("victim.mcap")
    victim.write_bytes(flip(data, data.index(b"sampling_expert"), 0))
    with EpisodeReader(victim) as log:
        assert log.info == episode.info
    assert "data section" in check(victim).problems[0]


def test_recovery_of_a_fine_log_keeps_all(log_path, episode, assert_same, tmp_path):
    report = recover(log_path, tmp_path / "copy.mcap")
    assert (report.steps_kept, report.bytes_dropped, report.outcome_kept) == (23, 0, True)
    assert assert_recovered(tmp_path / "copy.mcap", episode, assert_same, 23) == 23
    with pytest.raises(EpisodeWriteError, match="exists already: name another file"):
        recover(log_path, log_path)


def write_container(path, metadata: dict[str, dict[str, str]]) -> None:
    file = McapFile(path)
    for name, values in metadata.items():
        file.add_metadata(name, values)
    file.close_with_index()


def test_foreign_and_newer_logs_are_refused(episode, tmp_path):
    foreign, newer, bare = (tmp_path / f"{name}.mcap" for name in ("foreign", "newer", "bare"))
    write_container(foreign, {"robot": {"name": "arm"}})
    said = seal_episode(episode.info, episode.cameras)["json"]
    write_container(newer, {"endonav.episode": sealed(said, "2")})
    write_container(bare, {"endonav.episode": {"json": json.dumps({})}})
    with pytest.raises(EpisodeReadError, match=r"has no metadata record endonav\.episode"):
        EpisodeReader(foreign)
    for use in (EpisodeReader, lambda path: recover(path, tmp_path / "saved.mcap")):
        with pytest.raises(EpisodeReadError, match="has schema version 2, this reader knows up to 1"):
            use(newer)
    with pytest.raises(EpisodeReadError, match="has no schema version"):
        EpisodeReader(bare)


def test_check_finds_what_checksums_cannot(episode, tmp_path):
    """A log whose bytes are whole may still tell nonsense."""
    episode.records[3] = replace(episode.records[3], tip=np.array([0.0, np.nan, 0.0]))
    episode.records[4] = replace(episode.records[4], extra={"distance_m": float("inf")})
    path = episode.write(tmp_path / "nan.mcap")
    assert check(path).problems == [
        "step 3 has a non-finite number in tip",
        "step 4 has a non-finite number in extra distance_m",
    ]


fork = multiprocessing.get_context("fork")


def write_for_ever(episode, path, flush_every, given) -> None:
    """Write until killed, telling after every step how many were given."""
    log = episode.writer(path, flush_every=flush_every)
    pictures = {"images": {"frontal": episode.images[0]}, "masks": {"frontal": episode.masks[0]}}
    for step in range(10**9):
        log.step(replace(episode.records[step % 23], step=step), **pictures)
        given.value = step + 1


@pytest.mark.parametrize("seed", range(3))
def test_kill_at_any_moment_loses_at_most_ten_steps(episode, assert_same, tmp_path, seed):
    rng = np.random.default_rng(seed)
    path = tmp_path / "episode.mcap"
    given = fork.Value("q", 0, lock=False)
    process = fork.Process(target=write_for_ever, args=(episode, path, (8, 10)[seed % 2], given), daemon=True)
    process.start()
    try:
        deadline = time.monotonic() + 20
        wanted = int(rng.integers(20, 300))
        while given.value < wanted and time.monotonic() < deadline:
            time.sleep(0.0005)
        time.sleep(rng.uniform(0, 0.002))
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.join()
    assert given.value >= wanted
    assert not path.exists()
    report = recover(tmp_path / "episode.mcap.partial", path)
    assert report.steps_kept >= given.value - 10
    assert not check(path).problems
    with EpisodeReader(path) as log:
        assert log.outcome.status == "interrupted"
        assert log.outcome.success is None
        assert [record.step for record in log] == list(range(report.steps_kept))
        assert_same(log.step(22), replace(episode.records[22], step=22))


def write_into_a_limit(episode, path, limit, answer) -> None:
    """Write under a limit of file size, which the system reports as it does a full disk; tell what came of it."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    log = episode.writer(path)
    try:
        with log:
            for repetition in range(100):
                for record, image, mask in zip(episode.records, episode.images, episode.masks, strict=True):
                    step = 23 * repetition + record.step
                    log.step(replace(record, step=step), images={"frontal": image}, masks={"frontal": mask})
    except EpisodeWriteError as error:
        answer.send((str(error), log.steps_recorded, log.steps_safe))


def test_full_disk_keeps_what_was_flushed(episode, tmp_path):
    path = tmp_path / "episode.mcap"
    receiver, sender = fork.Pipe(duplex=False)
    process = fork.Process(target=write_into_a_limit, args=(episode, path, 120_000, sender))
    process.start()
    process.join(20)
    assert process.exitcode == 0
    assert receiver.poll(), "the writer met no limit"
    message, recorded, safe = receiver.recv()
    assert f"disk full while writing {path}: {safe} of {recorded} steps are safe in {path}.partial" in message
    assert 20 < recorded - 5 <= safe < recorded
    assert not path.exists()
    report = recover(tmp_path / "episode.mcap.partial", path)
    assert (report.steps_kept, report.bytes_dropped) == (safe, 0)
    assert not check(path).problems


def no_space(*unused: object) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_torn_write_is_cut_off_and_can_be_repeated(episode, tmp_path, monkeypatch):
    """Half of a chunk goes to disk, then there is no space; later there is."""
    write, full = os.pwrite, [False]

    def pwrite(fd: int, data: memoryview, offset: int) -> int:
        if not full[0]:
            return write(fd, data, offset)
        if offset % 2 or len(data) < 100:
            no_space()
        return write(fd, data[: len(data) // 2 | 1], offset)

    monkeypatch.setattr(os, "pwrite", pwrite)
    log = episode.writer(tmp_path / "episode.mcap")
    episode.record_steps(log, 0, 14)
    size = log.partial.stat().st_size
    full[0] = True
    with pytest.raises(EpisodeWriteError, match=r"disk full while writing .*: 10 of 15 steps are safe"):
        episode.record_steps(log, 14, 15)
    assert log.partial.stat().st_size == size
    with pytest.raises(EpisodeWriteError, match="disk full"):
        log.finish(replace(episode.outcome, steps=14))
    full[0] = False
    log.finish(replace(episode.outcome, steps=14))
    report = check(log.path)
    assert (report.problems, report.records) == ([], 15)


def test_full_disk_at_the_start_leaves_nothing(episode, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "pwrite", no_space)
    with pytest.raises(EpisodeWriteError, match=r"disk full while writing .* before its first step: free space"):
        EpisodeWriter(tmp_path / "episode.mcap", episode.info)
    assert list(tmp_path.iterdir()) == []


def test_unwritable_folder_is_said(episode, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(EpisodeWriteError, match=r"cannot make .*file: File exists; choose another folder"):
        EpisodeWriter(tmp_path / "file" / "episode.mcap", episode.info)


def test_a_log_that_is_being_written_is_left_to_its_writer(episode, tmp_path):
    path = tmp_path / "episode.mcap"
    log = episode.writer(path)
    episode.record_steps(log, 0, 14)
    with pytest.raises(EpisodeReadError, match="a writer is at work on it; wait until it ends"):
        recover(log.partial, tmp_path / "saved.mcap")
    with pytest.raises(EpisodeWriteError, match="another writer is at work on"):
        episode.writer(path, overwrite=True)
    episode.record_steps(log, 14)
    log.finish(episode.outcome)
    assert list(tmp_path.iterdir()) == [path]
    with EpisodeReader(path) as reader:
        assert (len(reader), reader.outcome) == (23, episode.outcome)


def test_what_came_in_the_place_of_a_log_meanwhile_stays(episode, tmp_path):
    path = tmp_path / "episode.mcap"
    log = episode.writer(path)
    episode.record_steps(log)
    whole = episode.write(tmp_path / "other.mcap").rename(path).read_bytes()
    with pytest.raises(EpisodeWriteError, match="exists already"):
        log.finish(episode.outcome)
    assert path.read_bytes() == whole
    path.unlink()
    partial = log.partial.rename(tmp_path / "moved")
    log.partial.write_bytes(b"another's")
    with pytest.raises(EpisodeWriteError, match="was removed or replaced while it was written"):
        log.finish(episode.outcome)
    log.abandon()
    assert not path.exists()
    assert log.partial.read_bytes() == b"another's"
    recover(partial, path)
    with EpisodeReader(path) as reader:
        assert len(reader) == 23
    empty = episode.writer(tmp_path / "empty.mcap")
    empty.partial.rename(tmp_path / "moved")
    empty.partial.write_bytes(b"another's")
    empty.abandon()
    assert empty.partial.read_bytes() == b"another's"


def test_failed_recovery_leaves_nothing(episode, tmp_path, monkeypatch):
    source = episode.write(tmp_path / "episode.mcap")

    monkeypatch.setattr(os, "pwrite", no_space)
    with pytest.raises(EpisodeWriteError, match="is unharmed: free space, or name another file, and try again"):
        recover(source, tmp_path / "saved.mcap")
    assert list(tmp_path.iterdir()) == [source]
