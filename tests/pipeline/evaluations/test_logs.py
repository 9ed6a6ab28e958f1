"""Logs of episodes as tables read them: which count, forces, a load cell; and learning tables, worked out by hand."""

import logging
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from cathsim.metrics.episodes import wilson_interval
from cathsim.metrics.forces import compare_forces
from pipeline.evaluations import forces
from pipeline.evaluations.forces import EpisodeForces
from pipeline.evaluations.logs import (
    EvaluationSet,
    UnusableLogError,
    changed_settings,
    evaluation_folders,
    read_evaluation,
    read_logs,
)
from pipeline.evaluations.tables import learning_tables, shortest_paths, tables_from_logs
from pipeline.plots.forces import draw_heat
from pipeline.stages.validate import table_rows
from pipeline.tables import check_cell
from tests.pipeline.evaluations.evaluation_logs import write_evaluation, write_force_log, write_row


def test_metrics_come_from_the_arrays_with_the_thesis_reward_also_of_a_failed_episode(tmp_path: Path) -> None:
    (path,) = write_row(tmp_path, "enn", "V", successes=(True,), steps=4, force=0.3, way=0.2, contacts=3)
    one = read_evaluation(path, tmp_path)
    assert (one.stage, one.row, one.variant, one.mode, one.training_seed) == ("enn", "V", "desk", "deterministic", 0)
    assert (one.phantom, one.target, one.folder, one.success_radius) == ("type_1", "bca", "enn", 0.008)
    # distances 0.1, 0.076, 0.052, 0.028, 0.004 m: three steps pay for theirs, the last one earns 10
    assert one.metrics.reward == pytest.approx(10 - 0.076 - 0.052 - 0.028)
    assert one.metrics.path_length == pytest.approx(0.2)
    assert one.metrics.force_mean == one.metrics.force_max == pytest.approx(0.3)  # the state after reset is no step
    assert one.contact_force == pytest.approx(0.1)
    assert (one.metrics.steps, one.metrics.success) == (4, True)
    (path,) = write_row(tmp_path, "enn", "V", successes=(False,), steps=2, contacts=0)
    one = read_evaluation(path, tmp_path)
    assert one.metrics.reward == pytest.approx(-0.065 - 0.03)
    assert one.contact_force is None


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"status": "interrupted"}, "broken off"),
        ({"end_distance": 0.02}, "claims success 20.0 mm from the target"),
        ({"outcome_success": False}, "its outcome says success=False"),
        ({"mode": "greedy"}, "its mode is 'greedy'"),
        ({"force": math.nan}, "must be finite"),
        ({}, "its metadata lacks mode, training_seed"),
    ],
)
def test_logs_that_do_not_count_say_why(tmp_path: Path, arguments: dict, reason: str) -> None:
    metadata = {"row": "V", "mode": "deterministic", "training_seed": 0, **arguments} if arguments else {"row": "V"}
    path = write_evaluation(tmp_path / "enn" / "000.mcap", **metadata)
    with pytest.raises(UnusableLogError, match=reason):
        read_evaluation(path, tmp_path)


def read(run: Path) -> EvaluationSet:
    return read_logs(evaluation_folders(run))


def test_one_damaged_log_among_others_is_left_out_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    paths = write_row(tmp_path, "enn", "V", successes=(True,) * 10)
    content = bytearray(paths[5].read_bytes())
    content[len(content) // 2] ^= 0xFF
    paths[5].write_bytes(content)
    reading = read(tmp_path)
    assert len(reading.evaluations) == 9
    assert list(reading.left_out) == [paths[5].relative_to(tmp_path).as_posix()]
    (warning,) = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert str(paths[5]) in warning
    assert "damaged" in warning
    assert tables_from_logs(tmp_path)["ablation"]["bca/V"]["n"] == 9


def test_an_episode_recorded_twice_counts_once_the_latest(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I", force=0.1, started_ns=2_000)
    write_row(tmp_path, "enn", "I", folder="enn@seed=0", force=0.2, started_ns=1_000)
    reading = read(tmp_path)
    assert [one.folder for one in reading.evaluations] == ["enn", "enn"]
    assert len(reading.left_out) == 2
    assert all("recorded again in enn/type_1" in reason for reason in reading.left_out.values())


def test_table_has_the_rows_of_the_thesis() -> None:
    drawn = np.random.default_rng(3).normal(0.40, 0.19, 400)
    comparison = compare_forces(drawn, real_mean_n=0.40, real_sd_n=0.19, generator=np.random.default_rng(0))
    rows = table_rows(comparison, np.array([0.02, 0.04]), "a", "d")
    assert {"u_statistic", "p_value", "shapiro_p", "levene_p", "simulated_force_n", "real_force_n"} <= set(rows)
    assert rows["simulated_force_n"] == {"value": pytest.approx([drawn.mean(), drawn.std()]), "n": 400}
    assert rows["pushed_force_n"]["value"] == pytest.approx([0.03, 0.01])


def test_logs_give_step_forces_and_contacts_without_the_reset(tmp_path: Path) -> None:
    write_force_log(tmp_path / "type_1/bca/000.mcap", np.array([0.0, 0.2, 0.4]))
    write_force_log(tmp_path / "type_2/lcca/000.mcap", np.array([0.1]), phantom="type_2", target="lcca")
    first, second = forces.read_forces(tmp_path)
    told = (first.phantom, first.target, first.operator, first.free_force_n)
    assert told == ("type_1", "bca", "sampling_expert", 0.15)
    assert first.magnitudes == pytest.approx([0.0, 0.2, 0.4])
    assert first.forces == pytest.approx([0.1, 0.1, 0.2, 0.2])
    assert first.points[:, 2] == pytest.approx([0.002, 0.002, 0.003, 0.003])
    assert len(forces.pooled([first, second])) == 4
    assert forces.pooled([]).shape == (0,)


LOADS = {"load_x_n": 0.3, "load_y_n": 0.0, "load_z_n": 0.4, "magnitude_sum_n": 0.9, "largest_contact_n": 0.45}


def arrays(steps: int = 20) -> dict[str, np.ndarray]:
    named = {f"extra/{name}": np.full(steps + 1, value) for name, value in LOADS.items()}
    named["extra/load_x_n"][0] = 99.0  # after reset
    return {"step": np.arange(steps + 1), **named}


def test_readings_are_those_of_the_steps_and_older_and_damaged_logs_have_none() -> None:
    found = forces.wall_forces(arrays(), interval=0.1, seed=1)
    assert found is not None
    assert found.load_cell_n.shape == (20,)
    assert found.load_cell_n == pytest.approx(0.5, abs=0.05)
    assert found.magnitude_sum_n == pytest.approx(0.9)
    mean, square = found.moments()["largest_contact_n"]
    assert (mean, square) == pytest.approx((0.45, 0.45**2))
    again = forces.wall_forces(arrays(), interval=0.1, seed=1)
    assert again is not None
    assert np.array_equal(again.load_cell_n, found.load_cell_n)
    older = {name: value for name, value in arrays().items() if name != "extra/magnitude_sum_n"}
    assert forces.wall_forces(older, interval=0.1, seed=0) is None
    damaged = arrays()
    damaged["extra/load_z_n"][3] = np.nan
    assert forces.wall_forces(damaged, interval=0.1, seed=0) is None
    assert forces.wall_forces({"step": np.array([0])}, interval=0.1, seed=0) is None


def test_device_is_the_catheter_that_a_log_names() -> None:
    assert forces.device_of({}) == forces.device_of({"catheter": None}) == "wire"
    assert forces.device_of({"catheter": {"outer_diameter": 0.002}, "catheter_preset": "simmons2"}) == "simmons2"
    own = [forces.device_of({"catheter": {"outer_diameter": size}, "catheter_preset": None}) for size in (0.002, 0.003)]
    assert all(name.startswith("own catheter ") for name in own)
    assert own[0] != own[1]


def test_table_pools_the_steps_of_operators_and_leaves_out_older_logs(tmp_path: Path) -> None:
    run = tmp_path / "run"
    folder = run / "expert/type_1/bca/evaluation"
    weaker = {"loads": {**LOADS, "magnitude_sum_n": 0.3}, "steps": 30}
    for seed, log in enumerate(({"loads": LOADS}, weaker, {}, {"loads": LOADS, "catheter": "simmons2"})):
        log = {"steps": 10, "operator": "sampling_expert", **log}
        write_evaluation(folder / f"{seed:03d}.mcap", seed=seed, **log)
    table = tables_from_logs(run)["load_cell"]
    assert set(table) == {f"type_1/bca/{device}/expert/sampling_expert" for device in ("wire", "simmons2")}
    row = table["type_1/bca/wire/expert/sampling_expert"]
    assert row["n"] == 2
    assert row["magnitude_sum_n"] == pytest.approx([0.45, np.std([0.9] * 10 + [0.3] * 30)])
    assert row["load_cell_n"][0] == pytest.approx(0.5, abs=0.02)


def test_forces_of_logs_are_joined(tmp_path: Path) -> None:
    for index, loads in enumerate((LOADS, None)):
        write_evaluation(tmp_path / f"{index}.mcap", loads=loads, steps=12)
    first, second = forces.read_forces(tmp_path)
    assert isinstance(first, forces.EpisodeForces)
    assert (first.device, second.wall) == ("wire", None)
    joined = forces.pooled_wall([first, second, first])
    assert isinstance(joined, forces.WallForces)
    assert all(len(getattr(joined, name)) == 24 for name in forces.QUANTITIES)
    assert forces.pooled_wall([second]) is None


def test_a_heat_map_has_the_colour_of_force_only_where_contacts_are(tmp_path: Path) -> None:
    vertices = np.asarray(trimesh.creation.icosphere(subdivisions=4, radius=0.02).vertices)
    points = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02], [0.02, 0.0, 0.0]])
    coloured = []
    for count in (0, 3):
        forces = np.array([0.3, 0.1, 0.2])[:count]
        episode = EpisodeForces("type_1", "bca", "sampling_expert", 0.15, np.ones(4), points[:count], forces)
        draw_heat(vertices, [episode], tmp_path / "heat.png", title="sphere")
        image = np.asarray(Image.open(tmp_path / "heat.png").convert("RGB"), dtype=int)
        image = image[:, : int(0.38 * image.shape[1])]  # columns up to the colour bar of the left picture
        coloured.append(((image[..., 0] > 200) & (image[..., 1] < 60)).sum())
    assert coloured[1] > coloured[0]


def test_shortest_way_is_that_of_the_whole_run_and_of_the_same_start_and_end(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "V", successes=(True, False), way=0.3)
    write_row(tmp_path, "baselines", "sac_image", successes=(True,), way=0.24)
    write_row(tmp_path, "baselines", "ppo_image", successes=(False,), way=0.1)  # failed
    write_row(tmp_path, "baselines", "ppo_image", successes=(True,), way=0.05, target="lcca")  # another target
    write_row(tmp_path, "baselines", "sac_internal", successes=(True,), way=0.1, task={"success_radius": 0.1})
    demonstration = {"stage": "enn", "row": "V", "mode": "deterministic", "training_seed": 0}
    write_evaluation(tmp_path / "enn/type_1/bca/V/seed0/expert/000.mcap", way=0.15, **demonstration)
    row = tables_from_logs(tmp_path)["ablation"]["bca/V"]
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
    reading = read_logs(evaluation_folders(tmp_path))
    assert "expected 'human'" in reading.left_out["human/type_1/bca/002.mcap"]
    shortest = shortest_paths([one for one in reading.evaluations if one.max_steps == 300])
    tables = learning_tables(reading.evaluations, shortest)
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
    for row in ("I+V+M", "V", "I"):
        write_row(tmp_path, "enn", row, successes=(row != "V",))
    for row in ("image_w_enn", "dagger"):
        write_row(tmp_path, "imitation", row, successes=(True,))
    expected = {"bca/enn", "bca/image_wo_enn", "bca/image_w_enn", "bca/dagger"}
    table = tables_from_logs(tmp_path)["imitation"]
    assert set(table) == expected
    assert table["bca/image_wo_enn"]["success_pct"] == [0, 0]


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


def test_each_device_has_a_line_with_its_success_and_forces(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I+V+M", successes=(True, False))
    for catheter, force in (("simmons2", -0.3), ("vertebral", 0.1)):
        one = {"successes": (True,), "folder": f"enn@task.catheter={catheter}", "catheter": catheter}
        for seed in range(2):
            write_row(tmp_path, "enn", "I+V+M", seed=seed, feeder_forces=(0.2, force * (seed + 1)), **one)
    tables = tables_from_logs(tmp_path)
    table = tables["devices"]
    catheters = ("", " (simmons2)", " (vertebral)")
    assert list(table) == [f"type_1/bca/enn/I+V+M/{device}" for device in ("wire", "simmons2", "vertebral")]
    bare, simmons = table["type_1/bca/enn/I+V+M/wire"], table["type_1/bca/enn/I+V+M/simmons2"]
    assert (bare["n"], simmons["n"]) == (2, 2)
    assert (bare["success_pct"][0], simmons["success_pct"][0]) == (50, 100)
    assert not any("feeder" in column for column in bare)
    assert simmons["wire_feeder_n"] == pytest.approx([0.2, 0.0])
    assert simmons["catheter_feeder_n"] == pytest.approx([0.45, 0.15])
    assert simmons["catheter_feeder_max_n"] == pytest.approx(0.6)
    assert set(tables["enn"]) == {f"type_1/bca/I+V+M{catheter}" for catheter in catheters}  # never pooled


def test_the_experts_episodes_are_told_apart(tmp_path: Path) -> None:
    for catheter in (None, "jb2"):
        log = tmp_path / f"expert/type_1/lcca/evaluation/{catheter}.mcap"
        write_evaluation(log, target="lcca", operator="sampling_expert", catheter=catheter, success=bool(catheter))
    tables = tables_from_logs(tmp_path)
    assert {row: cells["n"] for row, cells in tables["expert"].items()} == {"type_1/lcca": 1, "type_1/lcca (jb2)": 1}
    assert list(tables["devices"]) == [f"type_1/lcca/expert/sampling_expert/{device}" for device in ("wire", "jb2")]


def test_anatomies_of_one_name_have_rows_of_their_own(tmp_path: Path) -> None:
    for folder, patient in (("expert@phantom.file=a·aorta.stl", "a1"), ("expert@phantom.file=b·aorta.stl", "b2")):
        log = tmp_path / folder / "aorta/bca/evaluation/000.mcap"
        write_evaluation(
            log, phantom="aorta", phantom_hash=patient * 32, success=patient == "a1", operator="sampling_expert"
        )
    rows = {row: cells["success_pct"] for row, cells in tables_from_logs(tmp_path)["expert"].items()}
    assert rows == {"aorta a1a1a1/bca": [100.0, 0.0], "aorta b2b2b2/bca": [0.0, 0.0]}


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


def test_the_wire_alone_needs_no_table_of_devices_and_its_paths_are_not_compared_with_others(tmp_path: Path) -> None:
    bare = read_evaluation(write_row(tmp_path, "enn", "V")[0], tmp_path)
    assert "devices" not in tables_from_logs(tmp_path)
    assert (bare.device, bare.feeder_forces) == ("wire", None)
    other = read_evaluation(write_row(tmp_path, "enn", "V", catheter="jb2")[0], tmp_path)
    assert bare.task != other.task
