"""The imitation stage: one tiny run with everything it leaves, and bad input."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.episodes import EpisodeReader
from pipeline.evaluations.tables import tables_from_logs
from pipeline.jobs.worker import Report
from pipeline.recording.trials import MODES
from pipeline.report.headlines import headline_specs
from pipeline.seeds import held_out_seeds
from pipeline.stages import imitation
from pipeline.stages.imitation import imitate
from pipeline.stages.learning.settings import ImitationSettings
from pipeline.store.errors import ConfigurationError, StageError
from tests.pipeline.stages.small_expert import TASK, context, in_this_process, write_expert


@pytest.fixture(scope="module")
def enn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "enn"
    write_expert(folder)
    return folder


def settings(**changed) -> ImitationSettings:
    values = {
        "phantoms": ["type_1"],
        "targets": ["bca"],
        "episodes": [2, 4],
        "epochs": 1,
        "evaluation_episodes": 2,
        "drawn_episodes": 1,
        "dagger_rounds": 1,
        "dagger_episodes": 1,
        "disturbed_episodes": 1,
        "task": TASK.task,
    }
    return ImitationSettings(**{**values, **changed})


def test_a_run_leaves_students_logs_tables_and_a_figure(enn: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imitation, "run_jobs", in_this_process)
    place = context(enn.parent, "imitation")
    imitation.run_imitation(settings(), place).write(place.path)
    results = json.loads((place.path / "results.json").read_text())
    rows = {"image_w_enn_2", "image_w_enn", "image_w_enn_disturbed", "dagger"}
    assert {row.removeprefix("bca/") for row in tables_from_logs(place.path)["imitation"]} == rows
    assert set(results["imitation_episodes"]) == {"type_1/bca/2 episodes", "type_1/bca/4 episodes"}
    assert results["bc_architecture"]["linear_3"]["parameters"] == 258
    assert results["bc_architecture"]["conv_1"] | {} == {
        "output_shape": "32 × 19 × 19", "parameters": 2080, "nonlinearity": "ReLU", "kernel": 8, "stride": 4,
        "padding": 0,
    }  # fmt: skip
    assert results["bc_hyperparameters"]["epochs"]["value"] == 1
    assert results["dagger_rounds"]["type_1/bca/round 1"]["episodes"] == 3
    assert (place.path / "success.png").stat().st_size > 5000
    for row in rows:
        student = place.path / "type_1/bca" / row / "seed0"
        assert {"policy.pt", "training.csv", "training.json"} <= {path.name for path in student.iterdir()}
        with EpisodeReader(student / "evaluation/deterministic/000.mcap") as log:
            assert (log.info.seed, log.info.configuration["row"]) == (held_out_seeds(0, 1)[0], row)
            assert log.info.configuration["stage"] == "imitation"
        evaluated = {mode: len(list((student / "evaluation" / mode).iterdir())) for mode in MODES}
        assert evaluated == {"deterministic": 2, "stochastic": 1}


def test_the_default_student_learns_from_disturbed_episodes_and_a_plain_one_stands_beside_it(enn: Path) -> None:
    jobs = imitation.plan(
        ImitationSettings(phantoms=["type_1"], targets=["bca"], task=TASK.task), context(enn.parent, "x")
    )
    rows = {job.given.origin.row: job.given.disturbed_episodes for job in jobs}
    assert rows[imitation.DISTURBED] == 60
    assert rows[imitation.CLONED] == 0
    shown = {tuple(spec.measured or ()) for spec in headline_specs() if spec.table == "imitation"}
    assert shown == {("imitation", f"{target}/{imitation.DISTURBED}", "success_pct") for target in ("bca", "lcca")}


def test_a_finished_student_is_not_fitted_again(enn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = imitation.plan(settings(dagger_rounds=0, disturbed_episodes=0), context(enn.parent, "again"))[0].given
    job = replace(job, folder=tmp_path / "student")
    first = imitate(job, Report())
    monkeypatch.setattr("enn.imitation.distillation.clone", None)
    assert imitate(job, Report())["deterministic"] == first["deterministic"]


def test_no_episodes_is_one_sentence(enn: Path, tmp_path: Path) -> None:
    empty = tmp_path / "enn"
    shutil.copytree(enn, empty)
    shutil.rmtree(empty / "type_1/bca/I+V+M/seed0/expert")
    (tmp_path / "enn/type_1/bca/I+V+M/seed0/expert").mkdir()
    with pytest.raises(StageError, match="no expert episode to learn from: run stage=enn"):
        imitation.plan(settings(), context(tmp_path, "imitation"))
    with pytest.raises(StageError, match=r"has trained no I\+V\+M for type_2/bca: run stage=enn"):
        imitation.plan(settings(phantoms=["type_2"]), context(tmp_path, "imitation"))


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"episodes": [30, 10]}, "stage.episodes must rise"),
        ({"observations": ["joints"]}, "stage.observations has no 'joints': choose from image, mask"),
        ({"variant": "large"}, "stage.variant has no 'large'"),
        ({"epochs": -1}, "stage.epochs must be 0 or more"),
    ],
)
def test_settings_are_checked(changed: dict, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        settings(**changed)
