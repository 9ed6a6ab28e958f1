"""Reading of all logs: damaged ones are left out, repeated ones count once, known ones come from the cache."""

from __future__ import annotations

import logging
import os
import time
from pathlib import Path

import pytest

import pipeline.evaluations.logs as reading_module
from pipeline.evaluations.logs import (
    CACHE,
    evaluation_folders,
    read_evaluation,
    read_logs,
)
from pipeline.evaluations.tables import tables_from_logs
from tests.pipeline.evaluations.evaluation_logs import write_row


def read(run: Path, **arguments: object) -> reading_module.EvaluationSet:
    return read_logs(evaluation_folders(run), **arguments)  # type: ignore[arg-type]


def test_one_damaged_log_among_a_hundred_is_left_out_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    paths = write_row(tmp_path, "enn", "V", successes=(True,) * 100)
    content = bytearray(paths[57].read_bytes())
    content[len(content) // 2] ^= 0xFF
    paths[57].write_bytes(content)
    reading = read(tmp_path)
    assert len(reading.evaluations) == 99
    assert list(reading.left_out) == [paths[57].relative_to(tmp_path).as_posix()]
    (warning,) = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert str(paths[57]) in warning
    assert "damaged" in warning
    assert tables_from_logs(tmp_path)["ablation"]["bca/V"]["n"] == 99


def test_an_episode_recorded_twice_counts_once_the_latest(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I", force=0.1, started_ns=2_000)
    write_row(tmp_path, "enn", "I", folder="enn@seed=0", force=0.2, started_ns=1_000)
    reading = read(tmp_path)
    assert [one.folder for one in reading.evaluations] == ["enn", "enn"]
    assert len(reading.left_out) == 2
    assert all("recorded again in enn/type_1" in reason for reason in reading.left_out.values())


def test_known_logs_are_not_read_again_until_they_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = write_row(tmp_path, "enn", "I", successes=(True, True, False))
    cache = tmp_path / CACHE
    time.sleep(0.2)  # a file that was just written may still change
    first = read(tmp_path, cache=cache)
    asked: list[Path] = []

    def watched(path: Path, run_path: Path) -> object:
        asked.append(path)
        return read_evaluation(path, run_path)

    monkeypatch.setattr(reading_module, "read_evaluation", watched)
    assert read(tmp_path, cache=cache) == first
    assert asked == []
    write_row(tmp_path, "enn", "I", successes=(True,), force=0.7)
    os.utime(paths[0], ns=(1, 1))
    assert read(tmp_path, cache=cache).evaluations[0].metrics.force_max == pytest.approx(0.7)
    assert asked == [paths[0]]
    monkeypatch.setattr("pipeline.evaluations.logs.METRICS_VERSION", "other")
    read(tmp_path, cache=cache)
    assert len(asked) == 4, "another version computes them again"
    cache.write_text("{")
    assert len(read(tmp_path, cache=cache).evaluations) == 3


def test_processes_give_the_same_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (path, *_) = write_row(tmp_path, "enn", "I", successes=(True, False, True))
    path.write_bytes(b"no log")
    alone = read(tmp_path)
    monkeypatch.setattr(reading_module, "PARALLEL_FROM", 1)
    assert read(tmp_path, processes=2) == alone
    assert len(alone.left_out) == 1
