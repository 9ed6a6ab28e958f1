"""Training curves: read, and joined over seeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.evaluations.logs import evaluation_folders
from pipeline.report.learning_plots import Curve, join_seeds, read_columns, read_curves
from tests.pipeline.evaluations.evaluation_logs import write_curve


def curve(x: list[float], y: list[float], row: str = "V") -> Curve:
    return Curve("enn", "type_1", "bca", row, "seed0", {"decisions": np.array(x), "reward": np.array(y)})


def test_curves_are_found_with_their_row_and_a_cut_off_line_is_skipped(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_curve(tmp_path / "enn/type_1/bca/I+V/seed3")
    path.write_text(path.read_text() + "1100,44")
    write_curve(tmp_path / "enn@stage.decisions=9/type_2/lcca/V/seed0")
    empty = tmp_path / "enn/type_1/bca/V/seed0/training.csv"
    empty.parent.mkdir(parents=True)
    empty.write_text("decisions,reward\n")
    found = read_curves(evaluation_folders(tmp_path))
    assert [(one.stage, one.phantom, one.target, one.row, one.seed) for one in found] == [
        ("enn", "type_1", "bca", "I+V", "seed3"),
        ("enn", "type_2", "lcca", "V (stage.decisions=9)", "seed0"),
    ]
    decisions, success = found[0].pairs("decisions", "evaluation_success")
    np.testing.assert_allclose(decisions, [0, 200, 400, 600, 800, 1000])
    np.testing.assert_allclose(success, [0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert len(found[0].pairs("env_steps", "reward")[0]) == 11
    assert [len(part) for part in found[0].pairs("decisions", "no_such_column")] == [0, 0]
    assert str(empty) in caplog.text


def test_a_file_that_is_no_table_gives_nothing(tmp_path: Path) -> None:
    path = tmp_path / "training.csv"
    path.write_bytes(bytes(range(256)))
    assert read_columns(path) == {}
    assert read_columns(tmp_path / "missing.csv") == {}


def test_seeds_are_joined_only_where_all_of_them_trained() -> None:
    band = join_seeds([curve([0, 10], [0.0, 1.0]), curve([2, 4, 6], [1.0, 1.0, 1.0])], "decisions", "reward")
    assert band is not None
    assert (band.x[0], band.x[-1], band.seeds) == (2, 6, 2)
    np.testing.assert_allclose(band.mean, (band.x / 10 + 1) / 2)
    np.testing.assert_allclose(band.spread, np.abs(band.x / 10 - 1) / np.sqrt(2))
    alone = join_seeds([curve([0, 1], [3.0, np.nan]), curve([0, 1], [3.0, 5.0])], "decisions", "reward")
    assert alone is not None
    assert (alone.seeds, alone.mean[-1], alone.spread.max()) == (1, 5.0, 0.0)
    assert join_seeds([curve([0, 1], [0, 1]), curve([5, 6], [0, 1])], "decisions", "reward") is None
    assert join_seeds([], "decisions", "reward") is None
