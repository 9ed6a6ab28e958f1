"""Figures of learning: curves are read and joined right, each figure appears when there is something for it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from pipeline.report.figures import gather_figures
from pipeline.report.learning import figures as learning_figures
from pipeline.report.learning.curves import Curve, join_seeds, read_columns, read_curves
from pipeline.report.learning.figures import Material, draw_learning, task_words
from pipeline.report.learning.logs import evaluation_folders
from pipeline.report.learning.reading import read_logs
from pipeline.report.learning.tables import tables_from_logs
from pipeline.report.plots import learning as learning_plots
from pipeline.report.plots.learning import Point, draw_front, draw_generalisation, draw_training
from pipeline.report.results import Figure, write_figures
from tests.pipeline.report.evaluation_logs import write_curve, write_evaluation, write_row


def curve(x: list[float], y: list[float], row: str = "V") -> Curve:
    return Curve("enn", "type_1", "bca", row, "seed0", {"decisions": np.array(x), "reward": np.array(y)})


def material(run: Path, **tables: dict) -> Material:
    """What the report would draw from a run."""
    folders = evaluation_folders(run)
    evaluations = read_logs(folders).evaluations
    return Material(run, evaluations, read_curves(folders), {**tables_from_logs(run), **tables})


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


def test_an_empty_run_has_no_figures(tmp_path: Path) -> None:
    assert draw_learning(Material(tmp_path, [], [], {}), tmp_path / "figures") == []


def test_each_figure_appears_when_there_is_something_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wall = SimpleNamespace(vertices=np.zeros((5, 3)))
    monkeypatch.setattr("cathsim.load_phantom", lambda name: SimpleNamespace(name=name, lumen_mesh=wall))
    drawn: dict[str, list] = {"heat": [], "ways": [], "lengths": []}
    monkeypatch.setattr("pipeline.report.plots.forces.draw_heat", lambda *given, **more: drawn["heat"].append(given))
    monkeypatch.setattr(learning_plots, "draw_paths", lambda *given, **more: drawn["ways"].append((given, more)))
    monkeypatch.setattr(learning_plots, "draw_lengths", lambda *given: drawn["lengths"].append(given))
    run, folder = tmp_path / "run", tmp_path / "figures"
    for seed in range(2):
        write_row(run, "enn", "I+V+M", successes=(True, False), seed=seed)
        write_curve(run / f"enn/type_1/bca/I+V+M/seed{seed}")
    write_row(run, "enn", "I+V+M safe 0.5", force=0.05)
    write_row(run, "baselines", "sac_image", successes=(True,) * 3)
    write_curve(run / "baselines/type_1/bca/sac_image/seed0", evaluated=False)
    write_evaluation(run / "human/type_1/bca/000.mcap", operator="human", steps=9)
    # a phantom that the library does not know is in no picture of a vessel
    write_row(run, "enn", "I+V+M", phantom="mine")
    given = material(
        run, generalisation_curve={"roadmap/4": {"success_pct": 80.0}, "roadmap/16": {"success_pct": [90, 5]}}
    )
    figures = draw_learning(given, folder)
    assert [figure.title for figure in figures] == [
        "Training curves, baselines",
        "Training curves, enn",
        "Episode length during training",
        "Largest forces of the baselines",
        "Type I arch, BCA: contact forces of the baselines",
        "Type I arch, BCA: ways of the tip",
        "Success against force",
        "Success against training anatomies",
    ]
    written = {path.name for path in folder.glob("*.png")}
    assert written == {
        "training_baselines.png", "training_enn.png", "largest_forces.png", "front.png", "generalisation.png"
    }  # fmt: skip
    (_, human, _, _) = drawn["lengths"][0]
    assert {task: list(lengths) for task, lengths in human.items()} == {"Type I arch, BCA": [9.0]}
    (vessel, target, ways, _), more = drawn["ways"][0]
    assert (vessel.name, target, more["radius_mm"]) == ("type_1", "bca", pytest.approx(8))
    assert {who: [success for _, success in of_one] for who, of_one in ways.items()} == {
        "ENN": [True, False, True, False], "Human": [True]
    }  # fmt: skip
    vertices, episodes, _ = drawn["heat"][0]
    assert len(episodes) == 3
    assert vertices.shape == (5, 3)
    assert "24 contacts of 3 of 3 deterministic episodes" in figures[4].caption


def test_long_heat_maps_take_episodes_evenly(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I+V+M", successes=(True,) * 20)
    evaluations = read_logs(evaluation_folders(tmp_path)).evaluations
    taken = learning_figures._evenly(evaluations, 3)
    assert [one.seed % 1000 for one in taken] == [0, 10, 19]
    assert learning_figures._evenly([], 3) == []


def test_tasks_are_in_words() -> None:
    assert task_words("type_2", "lcca") == "Type II arch, LCCA"
    assert task_words("mine", "lsa") == "mine, LSA"


def image(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"))


def test_plots_show_what_they_are_given(tmp_path: Path) -> None:
    """A curve more, a weight more, an anatomy more: each darkens more pixels."""
    one, two = (
        {"V": [curve([0, 1, 2], [0, 1, 0])]},
        {"V": [curve([0, 1, 2], [0, 1, 0])], "I": [curve([0, 1, 2], [1, 0, 1])]},
    )
    for name, rows in (("one", one), ("two", two)):
        env_steps = {row: [Curve(*_head(c), {**c.columns, "env_steps": c.columns["decisions"]}) for c in cs]
                     for row, cs in rows.items()}  # fmt: skip
        draw_training({"task": env_steps}, {"I": "Internal"}, tmp_path / f"{name}.png")
    assert (image(tmp_path / "one.png") < 250).sum() < (image(tmp_path / "two.png") < 250).sum()
    points = [
        Point("a", "I+V+M", None, (0.2, 0.01), (100.0, 0.0), (0.9, 0.1), (90.0, 3.0)),
        Point("a", "safe 1", 1.0, (0.1, 0.01), (95.0, 2.0), (0.4, 0.1), (100.0, 2.0)),
    ]
    draw_front(points[:1], tmp_path / "front_1.png")
    draw_front(points, tmp_path / "front_2.png")
    assert (image(tmp_path / "front_1.png") != 255).sum() < (image(tmp_path / "front_2.png") != 255).sum()
    draw_generalisation({"roadmap": [(4, 80.0, 1.0), (1, 50.0, 0.0)]}, tmp_path / "generalisation.png")
    assert image(tmp_path / "generalisation.png").std() > 5


def _head(c: Curve) -> tuple[str, str, str, str, str]:
    return c.stage, c.phantom, c.target, c.row, c.seed


def test_figures_beyond_the_page_s_room_lie_beside_it(tmp_path: Path) -> None:
    stage, report = tmp_path / "learning", tmp_path / "report"
    for name, width in (("a", 1300), ("b", 300)):
        stage.mkdir(exist_ok=True)
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (40, width), dtype=np.uint8)).save(
            stage / f"{name}.png"
        )
    write_figures(stage, [Figure("A", "", "a.png"), Figure("B", "", "b.png")])
    wide, narrow = gather_figures("learning", stage, report, embed_limit=10**9, room=30_000)
    assert (wide.is_wide, narrow.is_wide) == (True, False)
    assert wide.source == "figures/learning/a.png"
    assert (report / wide.source).is_file()
    assert wide.embedded_bytes == 0
    assert narrow.embedded_bytes == len(narrow.source) > 1000
