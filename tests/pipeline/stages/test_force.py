"""The force stage: one tiny run with everything it leaves, what it learns from, and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.jobs.worker import Report
from pipeline.stages import force
from pipeline.stages.learning.expert_episodes import read_episodes
from pipeline.stages.learning.force import learn_force, samples_of
from pipeline.stages.learning.settings import ForceSettings
from pipeline.store.errors import ConfigurationError
from tests.pipeline.stages.small_expert import TASK, context, in_this_process, write_expert


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_expert(folder / "enn", episodes=1)
    return folder


def settings(**changed) -> ForceSettings:
    values = {
        "targets": ["bca"],
        "samples": [12, 30],
        "test_samples": 12,
        "epochs": 1,
        "inputs": ["V", "I+V", "V3"],
        "noise": 0.5,
        "task": TASK.task,
    }
    return ForceSettings(**{**values, **changed})


@pytest.fixture(scope="module")
def results(run: Path) -> dict:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(force, "run_jobs", in_this_process)
        force.run_force(settings(), context(run, "force")).write(run / "force")
    return json.loads((run / "force" / "results.json").read_text())


def test_a_run_leaves_episodes_networks_tables_and_figures(run: Path, results: dict) -> None:
    assert set(results["force_prediction_mse"]) == {
        *("baseline", "untrained", "fpn_12", "fpn_30", "shape", "shape_errors")
    }
    assert set(results["force_share"]) == {
        *("baseline", "fpn_12", "fpn_30", "fpn_30 I+V", "fpn_30 V3", "shape", "shape_errors")
    }
    for cells in results["force_share"].values():
        assert cells["share_pct"] == pytest.approx(100 * cells["mse_n2"] / cells["variance_n2"])
    assert results["force_distribution"]["test"]["n"] == 12
    assert {p.name for p in (run / "force").glob("*.png")} == {"calibration.png", "shares.png"}
    assert (run / "force/V/12/predictor.pt").is_file()
    steps = sum(map(len, read_episodes(sorted((run / "force/type_1/bca/episodes").glob("*.mcap")))))
    assert steps >= 44


def test_baseline_is_the_mean_of_the_training_samples(run: Path, results: dict) -> None:
    training, test = samples_of(force.plan(settings(), context(run, "force"))[1][1].given)
    assert (len(training), len(test)) == (30, 12)
    expected = np.square(test.forces.astype(float) - training.forces.astype(float).mean()).mean()
    assert results["force_prediction_mse"]["baseline"]["mse_n2"] == pytest.approx(expected)
    assert training.features is not None
    assert training.features.shape[1] > 3  # the expert's, and the wire's shape
    assert test.features is None


def test_a_fitted_network_is_kept(run: Path, results: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    job = force.plan(settings(), context(run, "force"))[1][0].given
    monkeypatch.setattr("enn.force.prediction.fit_force", None)
    assert learn_force(job, Report())["mse_n2"] == results["force_prediction_mse"]["fpn_12"]["mse_n2"]


def test_forces_that_are_all_the_same_have_no_share(run: Path, results: dict, tmp_path: Path) -> None:
    fit = force.plan(settings(), context(run, "force"))[1][0]
    outcome = {**learn_force(fit.given, Report()), "variance_n2": 0.0, "share_pct": None}
    assert force.tables([fit], {fit.key: outcome})["force_share"]["baseline"]["share_pct"] is None
    assert [one.file for one in force.figures([fit], {fit.key: outcome}, tmp_path)] == ["calibration.png"]


def test_names_of_rows() -> None:
    assert [force.row_of(count) for count in (1000, 10_000, 100_000, 200)] == [
        "fpn_1k", "fpn_10k", "fpn_100k", "fpn_200"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"inputs": ["X"]}, "stage.inputs has no 'X': choose from V, V_plain"),
        ({"samples": [100, 10]}, "stage.samples must rise"),
        ({"noise": -0.1}, "stage.noise must be 0 or more"),
    ],
)
def test_settings_are_checked(changed: dict, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        settings(**changed)


def test_settings_know_every_input() -> None:
    from enn.force import FORCE_INPUTS as KNOWN
    from pipeline.stages.learning.settings import FORCE_INPUTS

    assert tuple(KNOWN) == FORCE_INPUTS
