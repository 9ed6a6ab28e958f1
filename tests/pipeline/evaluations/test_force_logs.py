"""Forces read from logs: steps and contacts without the state after reset; the rows of the report's table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cathsim.metrics.forces import compare_forces
from pipeline.evaluations.forces import pooled, read_forces
from pipeline.stages.validate import table_rows
from tests.pipeline.evaluations.evaluation_logs import write_force_log


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
