"""Learning tables from logs, their figures worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import pipeline.evaluations.logs as reading_module
from cathsim.metrics.episodes import wilson_interval
from pipeline.evaluations.logs import changed_settings, evaluation_folders, read_evaluation, read_logs
from pipeline.evaluations.tables import learning_tables, log_summary, shortest_paths, tables_from_logs
from pipeline.report.tables import report_tables
from pipeline.store.errors import StageError
from pipeline.tables import check_cell
from tests.pipeline.evaluations.evaluation_logs import write_evaluation, write_row


def read(run: Path, **arguments: object) -> reading_module.EvaluationSet:
    return read_logs(evaluation_folders(run), **arguments)  # type: ignore[arg-type]


def test_a_folder_without_evaluations_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "enn").mkdir()
    with pytest.raises(
        StageError, match="enn holds no evaluation to make a table of: run stage enn again with force=true"
    ):
        tables_from_logs(tmp_path / "enn")
    write_evaluation(tmp_path / "enn" / "a.mcap")
    with pytest.raises(StageError, match=r"1 logs cannot be used, the first is enn/a\.mcap \(its metadata lacks row"):
        tables_from_logs(tmp_path / "enn")
    assert tables_from_logs(tmp_path) == {}


def test_shortest_way_is_that_of_the_whole_run_and_of_the_same_start_and_end(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "V", successes=(True, False), way=0.3)
    write_row(tmp_path, "baselines", "sac_image", successes=(True,), way=0.24)
    write_row(tmp_path, "baselines", "ppo_image", successes=(False,), way=0.1)  # failed
    write_row(tmp_path, "baselines", "ppo_image", successes=(True,), way=0.05, target="lcca")  # another target
    write_row(tmp_path, "baselines", "sac_internal", successes=(True,), way=0.1, task={"success_radius": 0.1})
    demonstration = {"stage": "enn", "row": "V", "mode": "deterministic", "training_seed": 0}
    write_evaluation(tmp_path / "enn/type_1/bca/V/seed0/expert/000.mcap", way=0.15, **demonstration)
    tables = tables_from_logs(tmp_path / "enn")
    assert set(tables) == {"ablation", "enn"}
    row = tables["ablation"]["bca/V"]
    assert row["spl_pct"] == pytest.approx(100 * (0.15 / 0.3 + 0) / 2)
    assert row["n"] == 2  # the demonstration belongs to no row, but its way counts
    assert tables_from_logs(tmp_path)["enn"]["type_1/bca/V"]["spl_pct"] == pytest.approx(25)


def test_thesis_tables_take_pairs_over_deterministic_episodes_of_all_seeds(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I+V+M", successes=(True, True), force=0.1)
    write_row(tmp_path, "enn", "I+V+M", successes=(True, False), force=0.3, seed=1)
    write_row(tmp_path, "enn", "I+V+M", successes=(False, False), mode="stochastic")
    write_row(tmp_path, "enn", "I+V+M", phantom="type_2", target="lcca")
    write_row(tmp_path, "baselines", "ppo_internal", steps=2, force=0.2)
    write_row(tmp_path, "baselines", "ppo_internal", successes=(False,), target="lcca", steps=2)
    tables = tables_from_logs(tmp_path)
    assert list(tables["ablation"]) == ["bca/I+V+M"]
    row = tables["ablation"]["bca/I+V+M"]
    assert row["success_pct"] == pytest.approx([75, 100 * math.sqrt(0.75 * 0.25)])
    assert row["force_n"] == pytest.approx([0.2, 0.1])
    assert row["n"] == 4
    cells = tables["cathsim_results"]["type_1/ppo_internal"]
    assert cells["reward_bca"] == pytest.approx([10 - 0.052, 0])
    assert cells["reward_lcca"] == pytest.approx([-0.065 - 0.03, 0])
    assert (cells["success_bca_pct"], cells["success_lcca_pct"], cells["n"]) == (100, 0, 1)
    assert cells["max_force_bca_n"] == pytest.approx([0.2, 0])
    for name, rows in tables.items():
        for key, columns in rows.items():
            for column, cell in columns.items():
                check_cell(cell, f"{name} / {key} / {column}")


def test_own_table_has_wilson_interval_and_spread_over_seeds(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I", successes=(True, True), force=0.1)
    write_row(tmp_path, "enn", "I", successes=(True, False), force=0.3, seed=1)
    write_row(tmp_path, "enn", "I", successes=(False, True, False), mode="stochastic", seed=1)
    row = tables_from_logs(tmp_path)["enn"]["type_1/bca/I"]
    assert row["success_pct"] == pytest.approx([75, np.std([100, 50], ddof=1)])
    assert row["force_n"] == pytest.approx([0.2, np.std([0.1, 0.3], ddof=1)])
    low, high = wilson_interval(3, 4)
    assert (row["success_low_pct"], row["success_high_pct"]) == pytest.approx((100 * low, 100 * high))
    assert row["stochastic_success_pct"] == pytest.approx(100 / 3)  # one seed has no spread
    assert (row["seeds"], row["n"], row["force_largest_n"]) == (2, 4, pytest.approx(0.3))


def test_people_and_the_planner_stand_beside_the_policies(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "V", successes=(True,), way=0.2)
    write_evaluation(tmp_path / "expert/type_1/bca/evaluation/000.mcap", operator="sampling_expert", way=0.1)
    write_evaluation(tmp_path / "expert/type_1/bca/000.mcap", operator="sampling_expert", success=False)
    write_evaluation(tmp_path / "human/type_1/bca/000.mcap", operator="human", way=0.4)
    write_evaluation(tmp_path / "human/type_1/bca/001.mcap", operator="human", task={"max_steps": 900}, way=0.01)
    write_evaluation(tmp_path / "human/type_1/bca/002.mcap", operator="sampling_expert")
    reading = read(tmp_path)
    assert "expected 'human'" in reading.left_out["human/type_1/bca/002.mcap"]
    tables = learning_tables(
        reading.evaluations, shortest_paths([o for o in reading.evaluations if o.max_steps == 300])
    )
    assert list(tables["ablation"]) == ["bca/V", "bca/sampling_expert", "bca/H"]
    assert tables["ablation"]["bca/H"]["spl_pct"] == pytest.approx(25)
    assert tables["ablation"]["bca/H"]["n"] == 1  # the other one had another limit
    assert tables["expert"]["type_1/bca"]["spl_pct"] == pytest.approx(100)
    assert tables["expert"]["type_1/bca"]["path_length_cm"] == pytest.approx([10, 0])
    assert (tables["expert"]["type_1/bca"]["n"], tables["human"]["type_1/bca"]["n"]) == (1, 1)
    assert tables["ablation"]["bca/sampling_expert"]["n"] == 1  # its demonstrations belong to no row


@pytest.mark.parametrize("other", [{"wire": {"length": 0.3}}, {"start_rotation": 3.14}, {"start_jitter": 0.0}])
def test_spl_is_measured_against_episodes_of_the_same_wire_and_start(tmp_path: Path, other: dict) -> None:
    write_row(tmp_path, "enn", "V", successes=(True,), way=0.2)
    write_row(tmp_path, "enn", "I", successes=(True,), way=0.1, task=other)
    write_evaluation(tmp_path / "expert/type_1/bca/000.mcap", operator="sampling_expert", way=0.05, task=other)
    tables = tables_from_logs(tmp_path)
    assert tables["enn"]["type_1/bca/V"]["spl_pct"] == pytest.approx(100)
    assert tables["enn"]["type_1/bca/I"]["spl_pct"] == pytest.approx(50)


def test_imitation_repeats_the_rows_of_the_ablation(tmp_path: Path) -> None:
    for stage, row in (
        ("enn", "I+V+M"),
        ("enn", "V"),
        ("enn", "I"),
        ("imitation", "image_w_enn"),
        ("imitation", "dagger"),
    ):
        write_row(tmp_path, stage, row, successes=(row != "V",))
    expected = {"bca/enn", "bca/image_wo_enn", "bca/image_w_enn", "bca/dagger"}
    own = tables_from_logs(tmp_path / "imitation")
    assert set(own["imitation"]) == expected
    assert set(own) == {"imitation", "behaviour_cloning"}
    assert own["imitation"]["bca/image_wo_enn"]["success_pct"] == [0, 0]
    assert set(tables_from_logs(tmp_path)["imitation"]) == expected


def test_unseen_anatomies_are_rows_by_test_set(tmp_path: Path) -> None:
    for seed in (7, 8):
        write_row(tmp_path, "unseen", "roadmap", phantom=f"random_{seed}", test_set="unseen", seed=0)
    write_row(tmp_path, "unseen", "roadmap", phantom="bovine")
    table = tables_from_logs(tmp_path)["generalisation"]
    assert {row: cells["n"] for row, cells in table.items()} == {"roadmap/bca/bovine": 2, "roadmap/bca/unseen": 4}
    write_row(tmp_path, "unseen", "roadmap", phantom="random_7", test_set="misregistered 2 mm")
    assert "roadmap_misregistered/bca/misregistered 2 mm" in tables_from_logs(tmp_path)["generalisation"]


def test_sweep_folders_join_by_seed_but_never_across_other_settings(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I", folder="enn@seed=0,target=bca", seed=0)
    write_row(tmp_path, "enn", "I", folder="enn@modality=I,seed=1", seed=1)
    write_row(tmp_path, "enn", "I", folder="enn@stage.decisions=500", successes=(False,))
    write_row(tmp_path, "enn", "I", folder="enn@seed=2", successes=(False,), variant="thesis", seed=2)
    table = tables_from_logs(tmp_path)["enn"]
    counts = {row: (cells["n"], cells["seeds"]) for row, cells in table.items()}
    assert counts == {
        "type_1/bca/I": (1, 1),  # the thesis's variant takes the plain name
        "type_1/bca/I (desk)": (4, 2),
        "type_1/bca/I (desk, stage.decisions=500)": (1, 1),
    }
    assert changed_settings("enn") == changed_settings("enn@seed=1,phantom.file=a.stl") == ""
    assert changed_settings("expert@phantom.entry=ascending,target=bca") == "phantom.entry=ascending"


def test_weights_of_the_force_are_rows_of_their_own(tmp_path: Path) -> None:
    for seed, weight in enumerate((0.5, 2.0)):
        write_row(tmp_path, "enn", "I+V+M safe", force_weight=weight, seed=seed)
    assert list(tables_from_logs(tmp_path)["ablation"]) == ["bca/I+V+M safe 0.5", "bca/I+V+M safe 2"]


def test_a_stage_logs_the_success_of_its_rows(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    write_row(tmp_path, "enn", "V", successes=(True, False), force=0.25)
    log_summary(tmp_path / "enn")
    assert "type_1/bca/V: success 50 %, force 0.25 N, 2 episodes" in caplog.text


def test_each_device_has_a_line_with_its_success_and_forces(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I+V+M", successes=(True, False))
    for catheter, force in (("simmons2", -0.3), ("vertebral", 0.1)):
        for index, success in enumerate((True, True)):
            write_row(
                tmp_path,
                "enn",
                "I+V+M",
                successes=(success,),
                folder=f"enn@stage.catheter={catheter}",
                seed=index,
                catheter=catheter,
                feeder_forces=(0.2, force * (index + 1)),
            )
    tables = tables_from_logs(tmp_path)
    table = tables["devices"]
    assert list(table) == [f"type_1/bca/enn/I+V+M/{device}" for device in ("wire", "simmons2", "vertebral")]
    bare, simmons = table["type_1/bca/enn/I+V+M/wire"], table["type_1/bca/enn/I+V+M/simmons2"]
    assert (bare["n"], simmons["n"]) == (2, 2)
    assert (bare["success_pct"][0], simmons["success_pct"][0]) == (50, 100)
    assert not any("feeder" in column for column in bare)
    assert simmons["wire_feeder_n"] == pytest.approx([0.2, 0.0])
    assert simmons["catheter_feeder_n"] == pytest.approx([0.45, 0.15])
    assert simmons["catheter_feeder_max_n"] == pytest.approx(0.6)
    assert set(tables["enn"]) == {
        f"type_1/bca/I+V+M{catheter}" for catheter in ("", " (simmons2)", " (vertebral)")
    }  # never pooled
    shown = next(one for one in report_tables(tables) if one.key == "devices")
    assert [column.label for column in shown.columns][-1] == "Catheter's feeder, largest"


def test_the_experts_episodes_are_told_apart(tmp_path: Path) -> None:
    for index, catheter in enumerate((None, "jb2")):
        write_evaluation(
            tmp_path / f"expert/type_1/lcca/evaluation/{index:03d}.mcap",
            target="lcca",
            success=index == 1,
            operator="sampling_expert",
            catheter=catheter,
        )
    tables = tables_from_logs(tmp_path)
    assert {row: cells["n"] for row, cells in tables["expert"].items()} == {"type_1/lcca": 1, "type_1/lcca (jb2)": 1}
    assert list(tables["devices"]) == [f"type_1/lcca/expert/sampling_expert/{device}" for device in ("wire", "jb2")]


def test_the_experts_tasks_of_a_sweep_have_rows_of_their_own(tmp_path: Path) -> None:
    folders = ("expert", "expert@task.success=lumen", "expert@task.success=straight")
    for folder in folders:
        log = tmp_path / folder / "type_1/bca/evaluation/000.mcap"
        write_evaluation(log, success=folder == folders[1], operator="sampling_expert")
    table = tables_from_logs(tmp_path)["expert"]
    assert {row: (cells["success_pct"], cells["n"]) for row, cells in table.items()} == {
        "type_1/bca": ([0.0, 0.0], 1),
        "type_1/bca (task.success=lumen)": ([100.0, 0.0], 1),
        "type_1/bca (task.success=straight)": ([0.0, 0.0], 1),
    }


def test_the_wire_alone_needs_no_table_of_devices(tmp_path: Path) -> None:
    logs = write_row(tmp_path, "enn", "I+V+M")
    assert "devices" not in tables_from_logs(tmp_path)
    one = read_evaluation(logs[0], tmp_path)
    assert (one.device, one.feeder_forces) == ("wire", None)


def test_paths_of_different_devices_are_not_compared(tmp_path: Path) -> None:
    bare = read_evaluation(write_row(tmp_path, "enn", "V")[0], tmp_path)
    other = read_evaluation(write_row(tmp_path, "enn", "V", catheter="jb2")[0], tmp_path)
    assert bare.task != other.task
