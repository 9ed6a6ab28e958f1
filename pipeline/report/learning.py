"""The learning part of the report: tables computed from the logs of a run, logs that are left out, figures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.evaluations.logs import (
    COUNTED,
    LEARNING_STAGES,
    Evaluation,
    EvaluationSet,
    Task,
    evaluation_folders,
    read_logs,
    stage_of,
)
from pipeline.evaluations.tables import OWN_TABLES, learning_tables, shortest_paths
from pipeline.report.learning_figures import Material, draw_learning
from pipeline.report.learning_plots import read_curves
from pipeline.report.tables import join_sweep
from pipeline.store.atomic_files import read_json
from pipeline.store.manifest import Manifest
from pipeline.tables import Table, read_results, write_figures

_EXPERT, _HUMAN = "expert", "human"
_USER_STUDY = "user_study"  # selects the episodes of people that count
_SHOWN = 5  # logs left out that the page names


@dataclass(frozen=True)
class LearningSection:
    """What the report takes from here."""

    results: list[dict[str, Table]]  # the tables from the logs, then those that each stage folder wrote
    variants: list[str]  # of each: see `join_sweep`
    by_seed: dict[int, dict[str, Table]]  # seed -> the same tables, joined, of stages that ran with several seeds alone
    remarks: dict[str, str]  # table -> what is to be said of it
    folder: Path | None = None  # where the figures lie with their list; None where there are none


def learning_section(run_path: Path, finished: Mapping[str, Manifest], figures: Path) -> LearningSection:
    """Computes the tables of finished stages' episodes from their logs, over seeds where there are several, and draws.

    Args:
        finished: stage folder to its manifest.
        figures: folder for the figures.
    """
    counting = {*finished, *([_HUMAN] if _USER_STUDY in finished else [])}
    folders = [folder for folder in evaluation_folders(run_path) if folder.name in counting]
    evaluation_set = read_logs(folders)
    selected = run_path / _USER_STUDY / COUNTED
    people = set(read_json(selected)) if selected.is_file() else set()
    evaluations = [one for one in evaluation_set.evaluations if one.stage != _HUMAN or one.log in people]
    shortest = shortest_paths(evaluation_set.evaluations)
    results, variants = _results(run_path, finished, evaluations, shortest), _variants(finished.values())
    by_seed = {
        seed: join_sweep(
            _results(run_path, names, [one for one in evaluations if one.folder in names], shortest),
            _variants(finished[name] for name in names),
        )
        for seed, names in _repeated({name: manifest.seed for name, manifest in finished.items()}).items()
    }
    learnt = [name for name in finished if stage_of(name) in LEARNING_STAGES]
    if not learnt:
        return LearningSection(results, variants, by_seed, left_out(evaluation_set))
    curves = read_curves([run_path / name for name in learnt])
    write_figures(figures, draw_learning(Material(run_path, evaluations, curves), figures))
    return LearningSection(results, variants, by_seed, left_out(evaluation_set), figures)


def _results(
    run_path: Path, folders: Collection[str], evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]
) -> list[dict[str, Table]]:
    """The tables from logs, then those that each folder wrote."""
    tables = learning_tables(evaluations, shortest)
    return [tables, *(read_results(run_path / name) for name in folders)]


def _variants(manifests: Iterable[Manifest]) -> list[str]:
    """What a sweep changed in each part of `_results`, but for its seed."""
    changed = (manifest.variant for manifest in manifests)
    return ["", *(", ".join(word for word in words if not word.startswith("seed=")) for words in changed)]


def _repeated(seeds: Mapping[str, int]) -> dict[int, list[str]]:
    """Seed to the folders of stages that ran with several seeds."""
    of_stage: dict[str, set[int]] = {}
    for name, seed in seeds.items():
        of_stage.setdefault(stage_of(name), set()).add(seed)
    repeated = {name: seed for name, seed in seeds.items() if len(of_stage[stage_of(name)]) > 1}
    return {seed: [name for name in repeated if repeated[name] == seed] for seed in sorted(set(repeated.values()))}


def left_out(found: EvaluationSet) -> dict[str, str]:
    """Words which logs do not count: own table of the stage to a sentence."""
    sentences = {}
    for stage in (*LEARNING_STAGES, _EXPERT):  # the stage user_study counts people's
        names = [name for name in found.left_out if stage_of(name.split("/", 1)[0]) == stage]
        if names:
            some = "; ".join(f"{name} ({_reason(found.left_out[name], name)})" for name in names[:_SHOWN])
            more = f"; and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            logs = "1 log was" if len(names) == 1 else f"{len(names)} logs were"
            sentences[OWN_TABLES[stage]] = f"{logs} left out: {some}{more}."
    return sentences


def _reason(message: str, name: str) -> str:
    """An error's reason without the path that stands beside it, nor the command that mends it."""
    reason = message.split("; run '", 1)[0]
    return reason.rpartition(f"{name} is ")[2] if f"{name} is " in reason else reason
