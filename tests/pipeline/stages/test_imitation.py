"""The stages imitation and force, which learn from an expert: a tiny run each with all it leaves, and bad input."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from enn.force.samples import FORCE_INPUTS as KNOWN
from pipeline.episodes import EpisodeReader
from pipeline.evaluations.tables import tables_from_logs
from pipeline.jobs.worker import Report
from pipeline.recording.trials import MODES
from pipeline.report.headlines import headline_specs
from pipeline.seeds import held_out_seeds
from pipeline.stages import force, imitation
from pipeline.stages.imitation import imitate
from pipeline.stages.learning.expert_episodes import read_episodes
from pipeline.stages.learning.force import learn_force, samples_of
from pipeline.stages.learning.settings import FORCE_INPUTS, ForceSettings, ImitationSettings
from pipeline.store.errors import ConfigurationError, StageError
from tests.pipeline.stages.small_expert import TASK, context, run_here, write_expert


@pytest.fixture(scope="module")
def enn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "enn"
    write_expert(folder)
    return folder


def settings(**changed) -> ImitationSettings:
    values = {"phantoms": ["type_1"], "targets": ["bca"], "episodes": [2, 4], "epochs": 1, "evaluation_episodes": 2}
    rounds = {"drawn_episodes": 1, "dagger_rounds": 1, "dagger_episodes": 1, "disturbed_episodes": 1}
    return ImitationSettings(**values | rounds | {"task": TASK.task} | changed)


def test_a_run_leaves_students_logs_and_tables(enn: Path, caplog) -> None:
    caplog.set_level("INFO")
    results = run_here(settings(), enn.parent, imitation)
    folder = enn.parent / "imitation"
    rows = {"image_w_enn_2", "image_w_enn", "image_w_enn_disturbed", "dagger"}
    assert {row.removeprefix("bca/") for row in tables_from_logs(enn.parent)["imitation"]} == rows
    assert "type_1/bca/dagger: success " in caplog.text
    assert set(results["imitation_episodes"]) == {"type_1/bca/2 episodes", "type_1/bca/4 episodes"}
    assert results["bc_architecture"]["linear_3"]["parameters"] == 258
    assert results["bc_architecture"]["conv_1"] | {} == {
        "output_shape": "32 × 19 × 19", "parameters": 2080, "nonlinearity": "ReLU", "kernel": 8, "stride": 4,
        "padding": 0,
    }  # fmt: skip
    assert results["bc_hyperparameters"]["epochs"]["value"] == 1
    assert results["dagger_rounds"]["type_1/bca/round 1"]["episodes"] == 3
    for row in rows:
        student = folder / "type_1/bca" / row / "seed0"
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


@pytest.mark.parametrize(("variant", "epochs"), [("desk", 10), ("thesis", 800)])
def test_passes_are_the_variant_s_unless_they_are_given(enn: Path, variant: str, epochs: int) -> None:
    usual = replace(settings(), variant=variant, epochs=ImitationSettings.epochs)
    for asked, passes in ((usual, epochs), (replace(usual, epochs=7), 7)):
        assert imitation.plan(asked, context(enn.parent, "passes"))[0].given.settings.fit.epochs == passes


def test_a_finished_student_is_not_fitted_again(enn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = imitation.plan(settings(dagger_rounds=0, disturbed_episodes=0), context(enn.parent, "again"))[0].given
    job = replace(job, folder=tmp_path / "student")
    first = imitate(job, Report())
    monkeypatch.setattr("enn.imitation.distillation.clone", None)
    assert imitate(job, Report())["deterministic"] == first["deterministic"]


def test_where_there_are_no_episodes_the_plan_is_refused_and_their_numbers_rise(enn: Path, tmp_path: Path) -> None:
    empty = tmp_path / "enn"
    shutil.copytree(enn, empty)
    shutil.rmtree(empty / "type_1/bca/I+V+M/seed0/expert")
    (tmp_path / "enn/type_1/bca/I+V+M/seed0/expert").mkdir()
    with pytest.raises(StageError, match="no expert episode to learn from"):
        imitation.plan(settings(), context(tmp_path, "imitation"))
    with pytest.raises(StageError, match=r"no I\+V\+M for type_2/bca"):
        imitation.plan(settings(phantoms=["type_2"]), context(tmp_path, "imitation"))
    with pytest.raises(ConfigurationError, match=r"stage\.episodes must rise"):
        settings(episodes=[30, 10])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_expert(folder / "enn", episodes=1)
    return folder


def of_force(**changed) -> ForceSettings:
    values = {"targets": ["bca"], "samples": [12, 30], "test_samples": 12, "epochs": 1}
    values |= {"inputs": ["V", "I+V", "V_plain"], "noise": 0.5, "task": TASK.task}
    return ForceSettings(**values | changed)


@pytest.fixture(scope="module")
def results(run: Path) -> dict:
    return run_here(of_force(), run, force)


def test_a_run_of_force_leaves_episodes_networks_tables_and_figures(run: Path, results: dict) -> None:
    assert set(results["force_prediction_mse"]) == {
        *("baseline", "untrained", "fpn_12", "fpn_30", "shape", "shape_errors")
    }
    assert set(results["force_share"]) == {
        *("baseline", "fpn_12", "fpn_30", "fpn_30 I+V", "fpn_30 V_plain", "shape", "shape_errors")
    }
    for cells in results["force_share"].values():
        assert cells["share_pct"] == pytest.approx(100 * cells["mse_n2"] / cells["variance_n2"])
    assert results["force_distribution"]["test"]["n"] == 12
    assert {p.name for p in (run / "force").glob("*.png")} == {"calibration.png"}
    assert (run / "force/V/12/predictor.pt").is_file()
    steps = sum(map(len, read_episodes(sorted((run / "force/type_1/bca/episodes").glob("*.mcap")))))
    assert steps >= 44


def test_baseline_is_the_mean_of_the_training_samples(run: Path, results: dict) -> None:
    training, test = samples_of(force.plan(of_force(), context(run, "force"))[1][1].given)
    assert (len(training), len(test)) == (30, 12)
    expected = np.square(test.forces.astype(float) - training.forces.astype(float).mean()).mean()
    assert results["force_prediction_mse"]["baseline"]["mse_n2"] == pytest.approx(expected)
    assert training.features is not None
    assert training.features.shape[1] > 3  # the expert's, and the wire's shape
    assert test.features is None


def test_a_fit_is_repeatable_and_forces_that_are_all_the_same_have_no_share(
    run: Path, results: dict, tmp_path: Path
) -> None:
    fit = force.plan(of_force(), context(run, "force"))[1][0]
    again = learn_force(replace(fit.given, folder=tmp_path / "again"), Report())
    assert again["mse_n2"] == results["force_prediction_mse"]["fpn_12"]["mse_n2"]
    outcome = {**again, "variance_n2": 0.0, "share_pct": None}
    assert force.tables([fit], {fit.key: outcome}, [])["force_share"]["baseline"]["share_pct"] is None
    assert [one.file for one in force.figures([fit], {fit.key: outcome}, tmp_path)] == ["calibration.png"]


def test_settings_know_every_input_and_rows_are_named_by_samples() -> None:
    assert tuple(KNOWN) == FORCE_INPUTS
    with pytest.raises(ConfigurationError, match=r"stage\.samples must rise"):
        of_force(samples=[100, 10])
    assert [force.row_of(count) for count in (1000, 10_000, 100_000, 200)] == [
        "fpn_1k", "fpn_10k", "fpn_100k", "fpn_200"
    ]  # fmt: skip
