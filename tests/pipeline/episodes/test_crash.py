"""Crashes of the writer: a kill at any moment and a full disk lose at most the steps since the last flush."""

from __future__ import annotations

import errno
import multiprocessing
import os
import resource
import signal
import time
from dataclasses import replace

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader, EpisodeWriteError, EpisodeWriter
from pipeline.episodes.checking import check
from pipeline.episodes.recovery import recover

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


def test_failed_recovery_leaves_nothing(episode, tmp_path, monkeypatch):
    source = episode.write(tmp_path / "episode.mcap")

    monkeypatch.setattr(os, "pwrite", no_space)
    with pytest.raises(EpisodeWriteError, match="is unharmed: free space and try again"):
        recover(source, tmp_path / "saved.mcap")
    assert list(tmp_path.iterdir()) == [source]
