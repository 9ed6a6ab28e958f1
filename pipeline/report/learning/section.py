"""The learning part of the report: tables computed from the logs of a run, logs that are left out, figures."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.report.learning.curves import read_curves
from pipeline.report.learning.figures import Material, draw_learning
from pipeline.report.learning.logs import COUNTED, LEARNING_STAGES, evaluation_folders, stage_of
from pipeline.report.learning.reading import CACHE, EvaluationSet, read_logs
from pipeline.report.learning.statistics import shortest_paths
from pipeline.report.learning.tables import OWN_TABLES, learning_tables
from pipeline.report.results import Table, read_results, write_figures
from pipeline.report.tables import join_sweep
from pipeline.store.atomic_files import read_json

_EXPERT, _HUMAN = "expert", "human"
_USER_STUDY = "user_study"  # selects the episodes of people that count
_SHOWN = 5  # logs left out that the page names


@dataclass(frozen=True)
class LearningSection:
    """What the report takes from here.

    Attributes:
        results: the tables from the logs, then those that each stage folder wrote.
        remarks: table -> what is to be said of it.
        folder: where the figures lie with their list; None where there are none.
    """

    results: list[dict[str, Table]]
    remarks: dict[str, str] = field(default_factory=dict)
    folder: Path | None = None


def learning_section(run_path: Path, finished: Collection[str], figures: Path) -> LearningSection:
    """Computes the tables of episodes from the logs, and draws.

    Args:
        run_path: the folder of the run.
        finished: names of its finished stage folders.
    """
    counting = {*finished, *([_HUMAN] if _USER_STUDY in finished else [])}
    folders = [folder for folder in evaluation_folders(run_path) if folder.name in counting]
    found = read_logs(folders, cache=run_path / CACHE)
    selected = run_path / _USER_STUDY / COUNTED
    people = set(read_json(selected)) if selected.is_file() else set()
    evaluations = [one for one in found.evaluations if one.stage != _HUMAN or one.log in people]
    tables = learning_tables(evaluations, shortest_paths(found.evaluations))
    written = [read_results(run_path / name) for name in finished]
    # runs of an earlier version wrote the tables of episodes, too
    results = [tables, *({name: rows for name, rows in part.items() if name not in tables} for part in written)]
    learnt = [name for name in finished if stage_of(name) in LEARNING_STAGES]
    if not learnt:
        return LearningSection(results, left_out(found))
    curves = read_curves([run_path / name for name in learnt])
    write_figures(figures, draw_learning(Material(run_path, evaluations, curves, join_sweep(results)), figures))
    return LearningSection(results, left_out(found), figures)


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
