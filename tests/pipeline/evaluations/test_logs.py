"""Logs of episodes as tables read them: which count, forces, and what a load cell reads."""

from __future__ import annotations

import logging
import math
import os
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pipeline.evaluations.logs as reading_module
from cathsim.metrics.forces import compare_forces
from pipeline.evaluations.forces import (
    QUANTITIES,
    EpisodeForces,
    WallForces,
    device_of,
    pooled,
    pooled_wall,
    read_forces,
    wall_forces,
)
from pipeline.evaluations.logs import CACHE, UnusableLogError, evaluation_folders, read_evaluation, read_logs
from pipeline.evaluations.tables import tables_from_logs
from pipeline.plots.forces import draw_quantities
from pipeline.stages.validate import table_rows
from tests.pipeline.evaluations.evaluation_logs import write_evaluation, write_force_log, write_row


def test_metrics_come_from_the_arrays_with_the_thesis_reward(tmp_path: Path) -> None:
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


def test_a_failed_episode_pays_for_every_step_and_has_no_contact_force_without_contacts(tmp_path: Path) -> None:
    (path,) = write_row(tmp_path, "enn", "V", successes=(False,), steps=2, contacts=0)
    one = read_evaluation(path, tmp_path)
    assert one.metrics.reward == pytest.approx(-0.065 - 0.03)
    assert one.contact_force is None


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"status": "interrupted"}, "its episode was broken off"),
        ({"end_distance": 0.02}, "claims success 20.0 mm from the target, the radius is 8 mm"),
        ({"outcome_success": False}, "its outcome says success=False, its last step True"),
        ({"mode": "greedy"}, "its mode is 'greedy', expected deterministic or stochastic"),
        ({"force": math.nan}, "force magnitudes must be finite"),
    ],
)
def test_logs_that_do_not_count_say_why(tmp_path: Path, arguments: dict, reason: str) -> None:
    metadata = {"row": "V", "mode": "deterministic", "training_seed": 0, **arguments}
    path = write_evaluation(tmp_path / "enn" / "000.mcap", **metadata)
    with pytest.raises(UnusableLogError, match=reason):
        read_evaluation(path, tmp_path)


def test_a_log_without_the_metadata_of_an_evaluation_is_none(tmp_path: Path) -> None:
    path = write_evaluation(tmp_path / "enn" / "000.mcap", row="V")
    with pytest.raises(UnusableLogError, match="its metadata lacks mode, training_seed"):
        read_evaluation(path, tmp_path)


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
    first, second = read_forces(tmp_path)
    assert (first.phantom, first.target, first.operator, first.free_force_n) == (
        "type_1",
        "bca",
        "sampling_expert",
        0.15,
    )
    assert first.magnitudes == pytest.approx([0.0, 0.2, 0.4])
    assert first.forces == pytest.approx([0.1, 0.1, 0.2, 0.2])
    assert first.points[:, 2] == pytest.approx([0.002, 0.002, 0.003, 0.003])
    assert len(pooled([first, second])) == 4
    assert pooled([]).shape == (0,)


LOADS = {"load_x_n": 0.3, "load_y_n": 0.0, "load_z_n": 0.4, "magnitude_sum_n": 0.9, "largest_contact_n": 0.45}


def arrays(steps: int = 20) -> dict[str, np.ndarray]:
    named = {f"extra/{name}": np.full(steps + 1, value) for name, value in LOADS.items()}
    named["extra/load_x_n"][0] = 99.0  # after reset
    return {"step": np.arange(steps + 1), **named}


def test_readings_are_those_of_the_steps() -> None:
    found = wall_forces(arrays(), interval=0.1, seed=1)
    assert found is not None
    assert found.load_cell_n.shape == (20,)
    assert found.load_cell_n == pytest.approx(0.5, abs=0.05)
    assert found.magnitude_sum_n == pytest.approx(0.9)
    mean, square = found.moments()["largest_contact_n"]
    assert (mean, square) == pytest.approx((0.45, 0.45**2))
    again = wall_forces(arrays(), interval=0.1, seed=1)
    assert again is not None
    assert np.array_equal(again.load_cell_n, found.load_cell_n)


def test_older_and_damaged_logs_have_none() -> None:
    older = {name: value for name, value in arrays().items() if name != "extra/magnitude_sum_n"}
    assert wall_forces(older, interval=0.1, seed=0) is None
    damaged = arrays()
    damaged["extra/load_z_n"][3] = np.nan
    assert wall_forces(damaged, interval=0.1, seed=0) is None
    assert wall_forces({"step": np.array([0])}, interval=0.1, seed=0) is None


def test_device_is_the_catheter_that_a_log_names() -> None:
    assert device_of({}) == device_of({"catheter": None}) == "wire"
    assert device_of({"catheter": {"outer_diameter": 0.002}, "catheter_preset": "simmons2"}) == "simmons2"
    assert device_of({"catheter": {"outer_diameter": 0.002}, "catheter_preset": None}) == "own catheter"


def test_table_pools_the_steps_of_operators_and_leaves_out_older_logs(tmp_path: Path) -> None:
    run = tmp_path / "run"
    folder = run / "expert/type_1/bca/evaluation"
    same = {"operator": "sampling_expert", "steps": 10}
    write_evaluation(folder / "000.mcap", seed=0, loads=LOADS, **same)
    write_evaluation(
        folder / "001.mcap", seed=1, loads={**LOADS, "magnitude_sum_n": 0.3}, operator="sampling_expert", steps=30
    )
    write_evaluation(folder / "002.mcap", seed=2, **same)
    write_evaluation(folder / "003.mcap", seed=3, loads=LOADS, catheter="simmons2", **same)
    table = tables_from_logs(run)["load_cell"]
    assert set(table) == {f"type_1/bca/{device}/expert/sampling_expert" for device in ("wire", "simmons2")}
    row = table["type_1/bca/wire/expert/sampling_expert"]
    assert row["n"] == 2
    assert row["magnitude_sum_n"] == pytest.approx([0.45, np.std([0.9] * 10 + [0.3] * 30)])
    assert row["load_cell_n"][0] == pytest.approx(0.5, abs=0.02)


def test_forces_of_logs_are_joined_and_drawn(tmp_path: Path) -> None:
    for index, loads in enumerate((LOADS, None)):
        write_evaluation(tmp_path / f"{index}.mcap", loads=loads, steps=12)
    first, second = read_forces(tmp_path)
    assert isinstance(first, EpisodeForces)
    assert (first.device, second.wall) == ("wire", None)
    joined = pooled_wall([first, second, first])
    assert isinstance(joined, WallForces)
    assert all(len(getattr(joined, name)) == 24 for name in QUANTITIES)
    assert pooled_wall([second]) is None
    draw_quantities(joined, 0.40, 0.19, tmp_path / "quantities.png")
    assert Image.open(tmp_path / "quantities.png").size[0] > 300
