"""The report's section on learning: results from logs, curves, figures and plots."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from pipeline.evaluations.logs import COUNTED, evaluation_folders, read_logs
from pipeline.report import learning_figures, learning_plots
from pipeline.report.learning import learning_section
from pipeline.report.learning_figures import Material, draw_learning
from pipeline.store.atomic_files import write_json
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.tables import write_results
from tests.pipeline.evaluations.evaluation_logs import write_curve, write_evaluation, write_row


def test_report_tabulates_the_logs_beside_what_results_say(tmp_path: Path, run_python: Callable[[str], str]) -> None:
    run = tmp_path / "tried"
    write_row(run, "enn", "V", phantom="mine")
    bad = write_row(run, "enn", "V", successes=(True,) * 3, phantom="mine")[2]
    bad.write_bytes(b"")
    write_results(run / "enn", {"own_table": {"a": {"b": 1.0}}})
    folder = RunFolder(run / "enn", Identity("c", {}, 1))
    folder.finish(stage="enn", run=run.name, budget="smoke", seed=0, config={}, started=0.0)
    printed = run_python(
        "import sys\nfrom pathlib import Path\nfrom tests.pipeline.stages.test_report import run_report\n"
        f"run_report(Path({str(tmp_path)!r}), 'tried')\nprint('torch' in sys.modules)"
    )
    assert printed.strip().endswith("False"), "the report must not import torch"
    page = (run / "report" / "index.html").read_text()
    assert "1 log was left out: enn/type_1" not in page
    assert "1 log was left out: enn/mine/bca/V/seed0/evaluation/deterministic/002.mcap" in page
    measured = json.loads((run / "report" / "metrics.json").read_text())
    assert measured["enn"]["mine/bca/V"]["success_pct"] == 100.0
    assert measured["own_table"]["a"]["b"] == 1.0


def finished(**seeds: int) -> dict:
    """Stage folder to what its manifest says, from its seed."""
    return {name: SimpleNamespace(seed=seed, variant=[]) for name, seed in seeds.items()}


def test_a_stage_that_has_not_finished_does_not_count(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "V")
    section = learning_section(tmp_path, {}, tmp_path / "figures")
    assert (section.results, section.folder) == ([{}], None)


def test_people_count_once_the_user_study_has_selected_their_logs(tmp_path: Path) -> None:
    for index in range(2):
        write_evaluation(tmp_path / f"human/type_1/bca/{index:03d}.mcap", operator="human")
    assert learning_section(tmp_path, {}, tmp_path / "figures").results == [{}]
    write_json(tmp_path / "user_study" / COUNTED, ["human/type_1/bca/001.mcap"])
    tables, written = learning_section(tmp_path, finished(user_study=0), tmp_path / "figures").results
    assert written == {}
    assert tables["human"]["type_1/bca"]["n"] == tables["ablation"]["bca/H"]["n"] == 1


def test_each_seed_of_a_repeated_stage_has_tables_of_its_own(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "V")
    write_row(tmp_path, "imitation", "bc", successes=(True, True))
    write_row(tmp_path, "imitation", "bc", successes=(True, False), folder="imitation@seed=1", seed=1)
    write_results(tmp_path / "imitation@seed=1", {"own": {"a": {"b": 2.0}}})
    manifests = finished(**{"enn": 0, "imitation": 0, "imitation@seed=1": 1})
    section = learning_section(tmp_path, manifests, tmp_path / "figures")
    assert set(section.by_seed) == {0, 1}
    shares = [tables["behaviour_cloning"]["type_1/bca/bc"]["success_pct"] for tables in section.by_seed.values()]
    assert shares == [100.0, 50.0]
    assert "enn" not in section.by_seed[0]
    assert section.by_seed[1]["own"] == {"a": {"b": 2.0}}
    once = finished(enn=0, imitation=0)
    assert learning_section(tmp_path, once, tmp_path / "figures").by_seed == {}


def test_an_empty_run_has_no_figures_and_long_heat_maps_take_episodes_evenly(tmp_path: Path) -> None:
    assert draw_learning(Material(tmp_path, [], []), tmp_path / "figures") == []
    assert learning_figures._evenly(range(20), 3) == [0, 10, 19]
    assert learning_figures._evenly([], 3) == []


def test_each_figure_appears_when_there_is_something_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wall = SimpleNamespace(vertices=np.zeros((5, 3)))
    monkeypatch.setattr("cathsim.load_phantom", lambda name: SimpleNamespace(name=name, lumen_mesh=wall))
    drawn: dict[str, list] = {"heat": [], "ways": [], "lengths": []}
    monkeypatch.setattr("pipeline.plots.forces.draw_heat", lambda *given, **more: drawn["heat"].append(given))
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
    folders = evaluation_folders(run)
    figures = draw_learning(Material(run, read_logs(folders).evaluations, learning_plots.read_curves(folders)), folder)
    assert len(figures) == 6
    written = {path.name for path in folder.glob("*.png")}
    assert written == {"training_baselines.png", "training_enn.png", "largest_forces.png"}
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
    assert "24 contacts of 3 of 3" in figures[4].caption


def curve(x: list[float], y: list[float], row: str = "V") -> learning_plots.Curve:
    values = {"decisions": np.array(x), "env_steps": np.array(x), "reward": np.array(y)}
    return learning_plots.Curve("enn", "type_1", "bca", row, "seed0", values)


def image(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"))


def test_plots_show_what_they_are_given(tmp_path: Path) -> None:
    """A curve more darkens more pixels."""
    one = {"V": [curve([0, 1, 2], [0, 1, 0])]}
    two = one | {"I": [curve([0, 1, 2], [1, 0, 1])]}
    for name, rows in (("one", one), ("two", two)):
        learning_plots.draw_training({"task": rows}, {"I": "Internal"}, tmp_path / f"{name}.png")
    assert (image(tmp_path / "one.png") < 250).sum() < (image(tmp_path / "two.png") < 250).sum()


def test_curves_are_found_and_a_cut_off_line_is_skipped(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_curve(tmp_path / "enn/type_1/bca/I+V/seed3")
    path.write_text(path.read_text() + "1100,44")
    write_curve(tmp_path / "enn@stage.decisions=9/type_2/lcca/V/seed0")
    empty = tmp_path / "enn/type_1/bca/V/seed0/training.csv"
    empty.parent.mkdir(parents=True)
    empty.write_text("decisions,reward\n")
    found = learning_plots.read_curves(evaluation_folders(tmp_path))
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
    path = tmp_path / "training.csv"
    path.write_bytes(bytes(range(256)))
    assert learning_plots.read_columns(path) == {}
    assert learning_plots.read_columns(tmp_path / "missing.csv") == {}


def test_seeds_are_joined_only_where_all_of_them_trained() -> None:
    band = learning_plots.join_seeds(
        [curve([0, 10], [0.0, 1.0]), curve([2, 4, 6], [1.0, 1.0, 1.0])], "decisions", "reward"
    )
    assert band is not None
    assert (band.x[0], band.x[-1], band.seeds) == (2, 6, 2)
    np.testing.assert_allclose(band.mean, (band.x / 10 + 1) / 2)
    np.testing.assert_allclose(band.spread, np.abs(band.x / 10 - 1) / np.sqrt(2))
    alone = learning_plots.join_seeds([curve([0, 1], [3.0, np.nan]), curve([0, 1], [3.0, 5.0])], "decisions", "reward")
    assert alone is not None
    assert (alone.seeds, alone.mean[-1], alone.spread.max()) == (1, 5.0, 0.0)
    assert learning_plots.join_seeds([curve([0, 1], [0, 1]), curve([5, 6], [0, 1])], "decisions", "reward") is None
    assert learning_plots.join_seeds([], "decisions", "reward") is None
