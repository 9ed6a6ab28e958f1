"""Trainings that two stages of a run define alike: made once, equal to those that each stage makes by itself."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from enn.policy import Policy
from pipeline.stages import baselines, enn
from pipeline.stages.learning import shared_training as sharing
from pipeline.stages.learning import training
from pipeline.stages.learning.settings import BaselinesSettings, EnnSettings
from pipeline.task import Task
from tests.pipeline.stages.small_expert import context, in_this_process

SIZES: dict[str, Any] = {
    "phantoms": ["type_1"], "targets": ["bca"], "decisions": 48, "evaluation_episodes": 1, "drawn_episodes": 0,
    "encoder_samples": 150, "encoder_epochs": 1, "task": Task(max_steps=12),
}  # fmt: skip
SAC_IMAGE, V = "baselines/type_1/bca/sac_image/seed0", "enn/type_1/bca/V/seed0"


@pytest.fixture(autouse=True)
def one_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    set_commit(monkeypatch, "c")


def set_commit(patch: pytest.MonkeyPatch, commit: str) -> None:
    patch.setattr(training, "run_jobs", in_this_process)
    patch.setattr(sharing, "present_commit", lambda: commit)
    patch.setattr(sharing, "uncommitted_changes", lambda: "")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose baselines are trained."""
    run = tmp_path_factory.mktemp("run")
    settings = BaselinesSettings(**SIZES, algorithms=["sac"], observations=["image"])
    place = context(run, "baselines", ("expert",))
    with pytest.MonkeyPatch.context() as patch:
        set_commit(patch, "c")
        training.run_trainings(baselines.plan(settings, place), settings, place)
    return run


def train_enn(run: Path) -> dict[str, Any]:
    """The record of the row V."""
    settings = EnnSettings(**SIZES, modality="V")
    place = context(run, "enn", ("expert",))
    training.run_trainings(enn.plan(settings, place), settings, place)
    return json.loads((run / V / "training.json").read_text())


def taken(run: Path, folder: Path, **changed: Any) -> bool:
    """Whether the row V, with its settings changed, finds its training."""
    (job,) = enn.plan(EnnSettings(**SIZES | changed, modality="V"), context(run, "enn", ("expert",)))
    job = replace(job, encoder=run / "baselines" / "encoders" / "type_1" / "image.pt")
    shared = training.shared_by(job, "cpu")
    return shared is not None and shared.take(folder, {})


def test_the_second_stage_takes_what_it_would_have_trained(trained: Path, tmp_path: Path) -> None:
    found, own = train_enn(trained), train_enn(tmp_path)
    assert found["metadata"]["taken_from"] == SAC_IMAGE
    assert "taken_from" not in own["metadata"]
    assert (found["metadata"]["stage"], found["metadata"]["row"]) == ("enn", "V")
    assert found["timings"] == json.loads((trained / SAC_IMAGE / "training.json").read_text())["timings"]
    policies = [Policy.load(run / V / "policy.pt") for run in (trained, tmp_path)]
    assert policies[0].metadata["row"] == "V"
    weights = [policy.module.actor.state_dict() for policy in policies]  # files keep no critics
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[1])
    for name in ("training.csv", "tensorboard", "evaluation/deterministic/000.mcap"):
        assert (trained / V / name).exists()


def test_other_definitions_or_commits_find_none(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert taken(trained, tmp_path / "same")
    assert not taken(trained, tmp_path / "longer", decisions=56)
    assert not taken(trained, tmp_path / "reward", path_penalty=1.0)
    for commit in ("d", "unknown"):
        monkeypatch.setattr(sharing, "present_commit", lambda commit=commit: commit)
        assert not taken(trained, tmp_path / commit)


@pytest.mark.parametrize("lost", ["policy.pt", "training.json", "training.csv"])
def test_files_that_were_lost_or_changed_are_not_taken(trained: Path, tmp_path: Path, lost: str) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    assert taken(run, tmp_path / "before")
    (run / SAC_IMAGE / lost).write_bytes(b"other") if lost == "policy.pt" else (run / SAC_IMAGE / lost).unlink()
    assert not taken(run, tmp_path / "after")
    assert not (tmp_path / "after").exists()  # nothing that a training of its own would go on with
