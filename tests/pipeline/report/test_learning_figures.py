"""Figures of learning: each appears when there is something for it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.evaluations.logs import evaluation_folders, read_logs
from pipeline.evaluations.tables import tables_from_logs
from pipeline.report import learning_figures, learning_plots
from pipeline.report.learning_figures import Material, draw_learning, task_words
from pipeline.report.learning_plots import read_curves
from tests.pipeline.evaluations.evaluation_logs import write_curve, write_evaluation, write_row


def material(run: Path, **tables: dict) -> Material:
    """What the report would draw from a run."""
    folders = evaluation_folders(run)
    evaluations = read_logs(folders).evaluations
    return Material(run, evaluations, read_curves(folders), {**tables_from_logs(run), **tables})


def test_an_empty_run_has_no_figures(tmp_path: Path) -> None:
    assert draw_learning(Material(tmp_path, [], [], {}), tmp_path / "figures") == []


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
    given = material(
        run, generalisation_curve={"roadmap/4": {"success_pct": 80.0}, "roadmap/16": {"success_pct": [90, 5]}}
    )
    figures = draw_learning(given, folder)
    assert [figure.title for figure in figures] == [
        "Training curves, baselines",
        "Training curves, ENN",
        "Episode length during training",
        "Largest forces of the baselines",
        "Type I arch, BCA: contact forces of the baselines",
        "Type I arch, BCA: paths of the tip",
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
