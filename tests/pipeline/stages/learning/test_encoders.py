"""Encoders of an anatomy: fitted to the same roll-outs, each as if it were alone, and only where it lacks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from enn.encoder import Encoder, EncoderSettings
from pipeline.jobs.worker import Report
from pipeline.stages.learning import encoders
from pipeline.stages.learning.encoders import EncodersJob, encoder_file, fit_encoders
from pipeline.stages.learning.task import LearningTask
from pipeline.task import Task

SETS = (("joints", "image"), ("image", "feeder"))


def job(folder: Path, *sets: tuple[str, ...]) -> EncodersJob:
    task = LearningTask("type_1", "bca", Task(image_size_px=36))
    return EncodersJob(folder, task, sets, EncoderSettings(epochs=1, seed=3), 120, ())


def test_encoders_share_roll_outs_and_are_as_if_alone(tmp_path: Path) -> None:
    told = fit_encoders(job(tmp_path / "both", *SETS), Report())
    assert list(told) == ["joints+image", "image+feeder"]
    for keys in SETS:
        (alone,) = fit_encoders(job(tmp_path / "alone", keys), Report()).values()
        name = "+".join(keys)
        assert {key: value for key, value in told[name].items() if not key.endswith("_s")} == {
            key: value for key, value in alone.items() if not key.endswith("_s")
        }
        one, other = (Encoder.load(encoder_file(tmp_path / place, keys)).state_dict() for place in ("both", "alone"))
        assert one.keys() == other.keys()
        assert all(torch.equal(one[part], other[part]) for part in one)


def test_an_encoder_that_is_there_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit_encoders(job(tmp_path, SETS[0]), Report())
    before = encoder_file(tmp_path, SETS[0]).read_bytes()
    asked = []
    samples = encoders._samples

    def only_what_lacks(given, sets, report):
        asked.extend(sets)
        return samples(given, sets, report)

    monkeypatch.setattr(encoders, "_samples", only_what_lacks)
    told = fit_encoders(replace(job(tmp_path, *SETS), samples=60), Report())
    assert asked == [SETS[1]]
    assert encoder_file(tmp_path, SETS[0]).read_bytes() == before
    assert [row["samples"] for row in told.values()] == [120, 60]
    assert fit_encoders(job(tmp_path, *SETS), Report()) == told
    assert asked == [SETS[1]]
