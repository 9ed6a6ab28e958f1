"""The learning section: the report shows the logs' tables, those of finished stages and of selected people."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from pipeline.evaluations.logs import (
    COUNTED,
)
from pipeline.evaluations.tables import tables_from_logs
from pipeline.report.learning import learning_section
from pipeline.store.atomic_files import write_json
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.tables import write_results
from tests.pipeline.evaluations.evaluation_logs import write_evaluation, write_row


def finish(run: Path, stage: str) -> None:
    """Makes a stage's folder a finished one."""
    folder = RunFolder(run / stage, Identity("c", {}, 1))
    folder.finish(stage=stage, run=run.name, budget="smoke", seed=0, config={}, started=0.0)


def test_report_tabulates_the_logs_beside_what_results_say(tmp_path: Path, run_python: Callable[[str], str]) -> None:
    run = tmp_path / "tried"
    write_row(run, "enn", "V", phantom="mine")
    tables_from_logs(run / "enn")  # keeps the metrics
    bad = write_row(run, "enn", "V", successes=(True,) * 3, phantom="mine")[2]
    bad.write_bytes(b"")
    write_results(run / "enn", {"own_table": {"a": {"b": 1.0}}})
    finish(run, "enn")
    printed = run_python(
        "import sys\n"
        "from pipeline.config import RunConfig\n"
        "from pipeline.stages.report import ReportSettings\n"
        "from pipeline.execution import execute\n"
        "config = RunConfig(stage=ReportSettings(), budget={'name': 'desk'}, name='tried', runs_dir="
        + repr(str(tmp_path))
        + ")\n"
        "execute(config)\n"
        "print('torch' in sys.modules)"
    )
    assert printed.strip().endswith("False"), "the report must not import torch"
    page = (run / "report" / "index.html").read_text()
    assert "1 log was left out: enn/type_1" not in page
    assert "1 log was left out: enn/mine/bca/V/seed0/evaluation/deterministic/002.mcap" in page
    measured = json.loads((run / "report" / "metrics.json").read_text())
    assert measured["enn"]["mine/bca/V"]["success_pct"] == 100.0
    assert measured["own_table"]["a"]["b"] == 1.0


def test_a_stage_that_has_not_finished_does_not_count(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "V")
    section = learning_section(tmp_path, [], tmp_path / "figures")
    assert section.results == [{}]
    assert section.folder is None


def test_people_count_once_the_user_study_has_selected_their_logs(tmp_path: Path) -> None:
    for index in range(2):
        write_evaluation(tmp_path / f"human/type_1/bca/{index:03d}.mcap", operator="human")
    assert learning_section(tmp_path, [], tmp_path / "figures").results == [{}]
    write_json(tmp_path / "user_study" / COUNTED, ["human/type_1/bca/001.mcap"])
    tables, written = learning_section(tmp_path, ["user_study"], tmp_path / "figures").results
    assert written == {}
    assert tables["human"]["type_1/bca"]["n"] == tables["ablation"]["bca/H"]["n"] == 1


def test_each_seed_of_a_repeated_stage_has_tables_of_its_own(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "V")
    write_row(tmp_path, "imitation", "bc", successes=(True, True))
    write_row(tmp_path, "imitation", "bc", successes=(True, False), folder="imitation@seed=1", seed=1)
    write_results(tmp_path / "imitation@seed=1", {"own": {"a": {"b": 2.0}}})
    seeds = {"enn": 0, "imitation": 0, "imitation@seed=1": 1}
    section = learning_section(tmp_path, list(seeds), tmp_path / "figures", seeds)
    assert set(section.by_seed) == {0, 1}
    shares = [tables["behaviour_cloning"]["type_1/bca/bc"]["success_pct"] for tables in section.by_seed.values()]
    assert shares == [100.0, 50.0]
    assert "enn" not in section.by_seed[0]
    assert section.by_seed[1]["own"] == {"a": {"b": 2.0}}
    assert learning_section(tmp_path, list(seeds), tmp_path / "figures").by_seed == {}
