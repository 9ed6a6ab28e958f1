"""What a load cell reads, from logs: with and without its quantities, by device, pooled over steps in the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.evaluations.forces import (
    QUANTITIES,
    EpisodeForces,
    WallForces,
    device_of,
    pooled_wall,
    read_forces,
    wall_forces,
)
from pipeline.evaluations.tables import tables_from_logs
from pipeline.plots.forces import draw_quantities
from tests.pipeline.evaluations.evaluation_logs import write_evaluation

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
