"""A human's logs: as whole as any other's, marked, with the questionnaire beside."""

import json
import logging
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.console.operator_setup import ForceLimit
from cathsim.console.procedure import Procedure
from cathsim.console.questionnaire import CRITERIA
from cathsim.console.recorder import OPERATION, TOTALS
from cathsim.console.xray.room import XRayStep
from pipeline.episodes import EpisodeReader, EpisodeWriter
from pipeline.episodes.__main__ import main as show
from pipeline.episodes.checking import check
from pipeline.evaluations.logs import COUNTED
from pipeline.evaluations.tables import tables_from_logs
from pipeline.recording.human import McapRecorder
from pipeline.stages.user_study import UserStudySettings, gather, logs_of, tables
from pipeline.tables import read_figures, read_results

ANSWERS = {**{criterion.key: 4 for criterion in CRITERIA}, "participant": "P1"}


@pytest.fixture(scope="module")
def environment() -> Iterator[NavigateEnv]:
    environment = NavigateEnv(observation="tip", accuracy="fast", max_steps=12)
    yield environment
    environment.close()


def play(environment: NavigateEnv, folder: Path, *, steps: int = 12, seed: int = 0) -> Procedure:
    """A procedure of straight insertion."""
    procedure = Procedure(environment, McapRecorder(folder), seed=seed)
    for _ in range(steps):
        procedure.step(1.0, 0.5)
    if steps < 12:
        procedure.break_off()
    assert not procedure.trouble
    return procedure


@pytest.fixture(scope="module")
def procedure(environment: NavigateEnv, tmp_path_factory: pytest.TempPathFactory) -> Procedure:
    return play(environment, tmp_path_factory.mktemp("human"))


def test_log_is_sound_and_says_that_a_human_steered(procedure: Procedure) -> None:
    path = procedure.path
    assert path is not None
    assert path.parts[-3:] == ("type_1", "bca", "000.mcap")
    assert check(path).problems == []
    with EpisodeReader(path) as log:
        assert (log.info.operator, log.info.phantom, log.info.target, log.info.seed) == ("human", "type_1", "bca", 0)
        assert (log.outcome.status, log.outcome.success, log.outcome.steps) == ("finished", False, 12)
        assert log.outcome.metrics["steps"] == 12
        arrays = log.load_arrays()
    np.testing.assert_array_equal(arrays["tip"], [sample.points[0] for sample in procedure.samples])
    np.testing.assert_array_equal(arrays["action"], [[0, 0], *[[1, 0.5]] * 12])
    assert arrays["truncated"].tolist() == [False] * 12 + [True]
    assert (arrays["image/frontal"][0] != arrays["image/frontal"][-1]).any()
    assert arrays["mask/frontal"][-1].sum() > arrays["mask/frontal"][0].sum()


def test_a_log_of_two_devices_has_both_and_the_catheters_name(tmp_path: Path) -> None:
    environment = NavigateEnv(observation="tip", accuracy="fast", max_steps=4, catheter="simmons2_6f", image_size=40)
    procedure = Procedure(environment, McapRecorder(tmp_path), seed=1)
    for _ in range(4):
        procedure.step(1.0, 0.0, (0.5, -1.0))
    assert not procedure.trouble
    assert procedure.path is not None
    assert check(procedure.path).problems == []
    with EpisodeReader(procedure.path) as log:
        assert (log.info.operator, log.info.catheter_name) == ("human", "simmons2_6f")
        records, arrays = list(log), log.load_arrays()
    assert arrays["mask_catheter/frontal"].shape == (5, 40, 40)
    assert np.diff(arrays["devices/lead"]).min() > 0
    np.testing.assert_array_equal([record.action for record in records], [[0] * 4, *[[1, 0, 0.5, -1]] * 4])
    for record, sample in zip(records, procedure.samples, strict=True):
        assert record.devices is not None
        assert sample.devices is not None
        assert record.devices.lead == sample.devices.lead
        assert tuple(record.devices.feeder_forces) == sample.devices.feeder_forces
    last = records[-1].devices
    assert last is not None
    np.testing.assert_array_equal(last.catheter_points, environment.simulation.device_points("catheter"))
    environment.close()


def test_a_broken_off_episode_is_kept_as_such_and_an_untouched_one_is_not(
    environment: NavigateEnv, tmp_path: Path
) -> None:
    play(environment, tmp_path, steps=3)
    play(environment, tmp_path, steps=0)
    (path,) = (entry for entry in tmp_path.rglob("*") if entry.is_file())
    with EpisodeReader(path) as log:
        assert (log.outcome.status, log.outcome.success, log.outcome.steps) == ("interrupted", None, 3)


def test_a_log_says_when_the_beam_was_on_what_was_injected_and_warned_of(
    environment: NavigateEnv, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    procedure = Procedure(environment, McapRecorder(tmp_path), seed=0, force_limit=ForceLimit(1e-6))
    for step in range(12):
        procedure.step(1.0, 0.5, xray=XRayStep(on=step % 3 != 2, injections=2 if step == 4 else 0))
    assert procedure.path is not None
    assert check(procedure.path).problems == []
    with EpisodeReader(procedure.path) as log:
        arrays, outcome, info = log.load_arrays(pictures=False), log.outcome, log.info
    assert arrays["extra/xray_on"].tolist() == [0, *[1, 1, 0] * 4]
    assert arrays["extra/injections"].tolist() == [0] * 5 + [2] + [0] * 7
    above = arrays["resultant_force_norm"] >= 1e-6
    np.testing.assert_array_equal(arrays["extra/force_warning"][1:], above[1:] & ~above[:-1])
    warnings = int(arrays["extra/force_warning"].sum())
    assert {name: outcome.metrics[name] for name in TOTALS} == {
        "fluoroscopy_time_s": 0.8, "injections": 2, "force_warnings": warnings,
    }  # fmt: skip
    assert (info.configuration["force_limit_n"], info.configuration["ends_at_force_limit"]) == (1e-6, False)
    assert show(["info", str(procedure.path)]) == 0
    assert re.search(r"metric fluoroscopy_time_s +0\.8\n", capsys.readouterr().out)
    broken = Procedure(environment, McapRecorder(tmp_path), seed=1)
    for _ in range(3):
        broken.step(1.0, 0.0)
    broken.break_off()
    assert broken.path is not None
    with EpisodeReader(broken.path) as log:
        assert log.outcome.status == "interrupted"
        assert log.outcome.metrics["fluoroscopy_time_s"] == pytest.approx(0.3)


def test_logs_with_and_without_the_x_ray_side_are_read_studied_and_exported_together(
    environment: NavigateEnv, tmp_path: Path
) -> None:
    folder = tmp_path / "human"
    new = play(environment, folder).path
    assert new is not None
    with (
        EpisodeReader(new) as log,
        EpisodeWriter(new.with_name("001.mcap"), log.info, phantom_mesh=log.phantom_mesh()) as old,
    ):
        for record in log:  # a log as it was written before there was any of this
            extra = {name: value for name, value in record.extra.items() if name not in OPERATION}
            old.step(replace(record, extra=extra))
        metrics = {name: value for name, value in log.outcome.metrics.items() if name not in TOTALS}
        old.finish(replace(log.outcome, metrics=metrics))
    assert len(gather(logs_of(tmp_path), UserStudySettings(max_steps=12)).counted) == 2
    assert lacking_xray(folder, tmp_path / "new_first") == [False, True]
    new.rename(new.with_name("002.mcap"))
    assert lacking_xray(folder, tmp_path / "old_first") == [True, False]


def lacking_xray(folder: Path, exported: Path) -> list[bool]:
    """Exports a folder of logs, and says of each whether it has no number in `xray_on`."""
    import h5py

    from pipeline.episodes.export.exporting import export_logs
    from pipeline.episodes.export.hdf5 import FILE

    export_logs(folder, "hdf5", exported, pictures=False)
    with h5py.File(exported / FILE) as file:
        values: list[np.ndarray] = []
        file.visititems(lambda key, one: values.append(one[()]) if key.endswith("xray_on") else None)
    return [bool(np.isnan(one).all()) for one in values]


def test_a_procedure_that_ends_at_the_force_limit_is_not_in_the_study(environment: NavigateEnv, tmp_path: Path) -> None:
    limit = ForceLimit(100.0, ends=True)
    procedure = Procedure(environment, McapRecorder(tmp_path / "human"), seed=0, force_limit=limit)
    for _ in range(12):
        procedure.step(1.0, 0.5)
    study = gather(logs_of(tmp_path), UserStudySettings(max_steps=12))
    assert (study.counted, study.other_settings) == ([], 1)


def test_a_questionnaire_is_beside_the_log(procedure: Procedure) -> None:
    path = procedure.path
    assert path is not None
    beside = procedure.answer(ANSWERS)
    assert beside == path.with_name("000.questionnaire.json")
    assert json.loads(beside.read_text())["answers"] == ANSWERS
    assert [entry.name for entry in sorted(path.parent.iterdir())] == ["000.mcap", "000.questionnaire.json"]


def test_the_study_counts_finished_procedures_under_its_own_settings(environment: NavigateEnv, tmp_path: Path) -> None:
    folder = tmp_path / "human"
    for seed in range(2):
        play(environment, folder, seed=seed)
    play(environment, folder, steps=2)
    (folder / "damaged.mcap").write_bytes(b"no log")
    logs = logs_of(tmp_path)
    assert len(logs) == 4
    study = gather(logs, UserStudySettings(max_steps=12))
    measured = tables(study)
    assert len(study.counted) == 2
    left_out = {"broken_off": 1, "other_settings": 0, "unreadable": 1}
    assert measured["human_left_out"] == {reason: {"episodes": count} for reason, count in left_out.items()}
    other = gather(logs, UserStudySettings())
    assert other.counted == [], "procedures of 12 steps say nothing about ones of 300"
    assert tables(other)["human_left_out"]["other_settings"] == {"episodes": 2}


def test_stage_fills_the_reports_tables_and_leaves_the_recordings_alone(
    environment: NavigateEnv, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    from pipeline.config import RunConfig
    from pipeline.execution import execute

    caplog.set_level(logging.INFO)
    config = RunConfig(stage=UserStudySettings(max_steps=12), name="tried", runs_dir=str(tmp_path))
    execute(config)
    stage = tmp_path / "tried" / "user_study"
    assert read_results(stage) == {}
    assert read_figures(stage) == []
    play(environment, tmp_path / "tried" / "human").answer(ANSWERS)
    execute(config)
    assert "up to date" not in caplog.text, "a new recording puts the stage out of date"
    execute(config)
    assert "up to date" in caplog.text
    results = read_results(stage)
    assert set(results) == {"user_study"}
    (log,) = logs_of(tmp_path / "tried")
    assert json.loads((stage / COUNTED).read_text()) == [log.relative_to(tmp_path / "tried").as_posix()]
    row = tables_from_logs(tmp_path / "tried")["ablation"]["bca/H"]
    assert (row["n"], row["episode_length_steps"], row["success_pct"]) == (1, [12.0, 0.0], [0.0, 0.0])
    assert results["user_study"]["anatomical_accuracy"] == {"score": [4.0, 0.0], "n": 1}
    assert [figure.file for figure in read_figures(stage)] == ["type_1/bca.png"]
    assert len(logs_of(tmp_path / "tried")) == 1


def test_rows_are_those_of_the_thesis() -> None:
    import yaml

    from pipeline.store.provenance import PROJECT_ROOT

    thesis = yaml.safe_load((PROJECT_ROOT / "pipeline" / "report" / "thesis.yaml").read_text())["tables"]
    assert list(thesis["user_study"]["rows"]) == [criterion.key for criterion in CRITERIA]
    assert {"bca/H", "lcca/H"} <= set(thesis["ablation"]["rows"])
