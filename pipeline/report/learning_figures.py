"""Figures of learning: which plots the report shows of the training curves and evaluation logs of a run."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.evaluations.forces import episode_forces
from pipeline.evaluations.logs import DETERMINISTIC, Evaluation
from pipeline.evaluations.tables import EXPERT_ROW, counted, named_rows, of_mode, row_place
from pipeline.plots import forces
from pipeline.plots.canvas import MM
from pipeline.report import learning_plots as plots
from pipeline.report.learning_plots import Curve
from pipeline.report.tables import group_labels, row_labels
from pipeline.tables import Figure

CURVES_GROUP = "Learning: training"
FORCES_GROUP = "Learning: forces"
PATHS_GROUP = "Learning: paths in the vessel"
HEAT_EPISODES = 42  # logs behind a heat map, evenly taken from all rows
PATHS_SHOWN = 10  # of each who steered
_LOGGER = logging.getLogger(__name__)
_STEERED = {"enn": "ENN", "expert": "Sampling expert", "human": "Human"}
_STAGE_WORDS = {"baselines": "baselines", "enn": "ENN", "imitation": "imitation", "unseen": "unseen anatomies"}
_LABELS = {"baselines": "cathsim_results", "enn": "ablation", "imitation": "imitation"}  # stage -> table with its words


@dataclass(frozen=True)
class Material:
    """What the figures are drawn from."""

    run_path: Path  # folder of the run, which the logs' names are relative to
    evaluations: Sequence[Evaluation]
    curves: Sequence[Curve]


def draw_learning(material: Material, folder: Path) -> list[Figure]:
    """Draws every figure that there is something for, as PNGs in a folder."""
    drawings = (_training, _lengths, _largest_forces, _heat, _paths)
    return [figure for draw in drawings for figure in draw(material, folder)]


def task_words(phantom: str, target: str) -> str:
    """A task in words, e.g. "Type I arch, BCA"."""
    groups = group_labels()
    return f"{groups.get(phantom, phantom)}, {groups.get(target, target.upper())}"


def _grouped(curves: Sequence[Curve]) -> dict[str, dict[str, list[Curve]]]:
    """Task to row to a curve a seed."""
    tasks: dict[str, dict[str, list[Curve]]] = {}
    for curve in sorted(curves, key=lambda one: (one.phantom, one.target, row_place(one.row), one.row, one.seed)):
        tasks.setdefault(task_words(curve.phantom, curve.target), {}).setdefault(curve.row, []).append(curve)
    return tasks


def _training(material: Material, folder: Path) -> list[Figure]:
    figures = []
    curves = [
        curve
        for curve in material.curves
        if any(len(curve.pairs(panel.x, panel.y)[0]) for panel in plots.TRAINING_PANELS)
    ]  # a supervised training has no reward
    for stage in dict.fromkeys(curve.stage for curve in curves):
        tasks = _grouped([curve for curve in curves if curve.stage == stage])
        file = f"training_{stage}.png"
        plots.draw_training(tasks, row_labels(_LABELS.get(stage, stage)), folder / file)
        seeds = max(len(of_row) for of_task in tasks.values() for of_row in of_task.values())
        spread = f"Thin: up to {seeds} seeds; thick: their mean, as far as all trained; band: ± one standard deviation."
        caption = (
            "The training's own reward (the tables have the thesis's), exploration included, and success of the "
            f"evaluated policy. {spread if seeds > 1 else 'One seed.'}"
        )
        figures.append(Figure(f"Training curves, {_STAGE_WORDS.get(stage, stage)}", caption, file, CURVES_GROUP, stage))
    return figures


def _lengths(material: Material, folder: Path) -> list[Figure]:
    curves = [curve for curve in material.curves if curve.stage == "enn"]
    if not any(len(curve.pairs("decisions", "evaluation_length")[0]) for curve in curves):
        return []
    tasks = _grouped([curve for curve in curves if curve.row == EXPERT_ROW] or curves)
    human = {
        task_words(phantom, target): np.array([float(one.metrics.steps) for one in episodes])
        for (stage, phantom, target, _), episodes in named_rows(material.evaluations).items()
        if stage == "human"
    }
    file = "episode_length.png"
    plots.draw_lengths(tasks, human, row_labels("ablation"), folder / file)
    beside = (
        "Dashed: people at the console, mean ± one standard deviation." if human else "There are no human episodes."
    )
    caption = f"Evaluated episode length by checkpoint; failures count with the step limit. {beside}"
    return [Figure("Episode length during training", caption, file, CURVES_GROUP, "enn")]


def _largest_forces(material: Material, folder: Path) -> list[Figure]:
    labels, groups = row_labels("cathsim_results"), group_labels()
    phantoms: dict[str, dict[tuple[str, str], NDArray[np.float64]]] = {}
    for (stage, phantom, target, row), evaluations in named_rows(material.evaluations).items():
        deterministic = of_mode(evaluations, DETERMINISTIC)
        if stage == "baselines" and deterministic:
            boxes = phantoms.setdefault(groups.get(phantom, phantom), {})
            boxes[labels.get(row, row), target] = np.array([one.metrics.force_max for one in deterministic])
    if not phantoms:
        return []
    file = "largest_forces.png"
    plots.draw_largest_forces(phantoms, folder / file)
    count = sum(len(values) for boxes in phantoms.values() for values in boxes.values())
    caption = (
        f"Largest resultant contact force of each of {count} evaluation episodes. Box: quartiles; whiskers: 5 and 95 %."
    )
    return [Figure("Largest forces of the baselines", caption, file, FORCES_GROUP, "baselines")]


def _heat(material: Material, folder: Path) -> list[Figure]:
    figures = []
    deterministic = of_mode([one for one in material.evaluations if one.stage == "baselines"], DETERMINISTIC)
    for phantom, target in sorted({(one.phantom, one.target) for one in deterministic}):
        of_task = [one for one in deterministic if (one.phantom, one.target) == (phantom, target)]
        vessel = _phantom(phantom, material.run_path / of_task[0].log)
        if vessel is None:
            continue
        episodes = [episode_forces(material.run_path / one.log) for one in _evenly(of_task, HEAT_EPISODES)]
        contacts = sum(len(episode.forces) for episode in episodes)
        if not contacts:
            continue  # the logs say nothing of single contacts
        file = f"heat_{phantom}_{target}.png"
        title = f"{task_words(phantom, target)}: contact forces of the baselines"
        forces.draw_heat(np.asarray(vessel.lumen_mesh.vertices, np.float64), episodes, folder / file, title=title)
        caption = f"{contacts} contacts of {len(episodes)} of {len(of_task)} deterministic episodes, all rows together."
        figures.append(Figure(title, caption, file, FORCES_GROUP, "baselines"))
    return figures


def _paths(material: Material, folder: Path) -> list[Figure]:
    from pipeline.episodes import EpisodeReader

    tasks: dict[tuple[str, str], dict[str, list[Evaluation]]] = {}
    for one in of_mode(counted(material.evaluations), DETERMINISTIC):
        if one.stage in _STEERED and (one.stage != "enn" or one.row == EXPERT_ROW):
            tasks.setdefault((one.phantom, one.target), {}).setdefault(_STEERED[one.stage], []).append(one)
    figures = []
    for (phantom, target), steered in sorted(tasks.items()):
        vessel = _phantom(phantom, material.run_path / steered["ENN"][0].log) if "ENN" in steered else None
        if vessel is None:
            continue
        paths: dict[str, list[tuple[NDArray[Any], bool]]] = {}
        for who in _STEERED.values():
            for one in _evenly(steered.get(who, []), PATHS_SHOWN):
                with EpisodeReader(material.run_path / one.log) as log:
                    tips = log.load_arrays(pictures=False)["tip"]
                paths.setdefault(who, []).append((tips, one.metrics.success))
        file = f"paths_{phantom}_{target}.png"
        radius_mm = MM * steered["ENN"][0].success_radius
        plots.draw_paths(vessel, target, paths, folder / file, radius_mm=radius_mm)
        caption = (
            f"Paths of the tip, at most {PATHS_SHOWN} episodes each; they end in a dot on success, in a cross "
            "otherwise. The target's sphere of success is dashed."
        )
        figures.append(Figure(f"{task_words(phantom, target)}: paths of the tip", caption, file, PATHS_GROUP, "enn"))
    return figures


def _evenly(evaluations: Sequence[Evaluation], most: int) -> list[Evaluation]:
    """At most so many, evenly from all seeds and rows."""
    places = np.linspace(0, len(evaluations) - 1, min(len(evaluations), most)).round().astype(int)
    return [evaluations[place] for place in places]


def _phantom(name: str, log: Path) -> Any:
    """A named phantom, or a log's file imported again; None for a random arch, or if the file is gone or changed."""
    from cathsim import PHANTOMS, load_phantom
    from pipeline.episodes import EpisodeReader, EpisodeReadError
    from pipeline.recording.record import ANATOMY
    from pipeline.recording.replay import recorded_phantom

    if name in PHANTOMS:
        return load_phantom(name)
    with EpisodeReader(log) as reader:
        info = reader.info
    try:
        return recorded_phantom(info) if ANATOMY in info.configuration else None
    except (EpisodeReadError, ValueError) as error:
        _LOGGER.warning("no picture of %s: %s", name, error)
        return None
