"""The learning part of the report: tables computed from the logs of a run, what differs from the stages', figures."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.report.learning.curves import read_curves
from pipeline.report.learning.differences import differences, remarks, with_logs
from pipeline.report.learning.figures import Material, draw_learning
from pipeline.report.learning.logs import LEARNING_STAGES, evaluation_folders, stage_of
from pipeline.report.learning.reading import CACHE, Reading, read_logs
from pipeline.report.learning.statistics import shortest_ways
from pipeline.report.learning.tables import OWN_TABLES, learning_tables, stage_tables
from pipeline.report.results import Table, read_results, write_figures
from pipeline.report.tables import join_sweep

_HUMAN, _USER_STUDY = "human", "user_study"  # people's episodes count once the stage that sums them up has run
_SHOWN = 5  # logs left out that the page names


@dataclass(frozen=True)
class LearningSection:
    """What the report takes from here.

    Attributes:
        results: of every stage folder, the logs' cells in the place of the stages'.
        remarks: table -> what is to be said of it.
        folder: where the figures lie with their list; None where there are none.
    """

    results: list[dict[str, Table]]
    remarks: dict[str, str] = field(default_factory=dict)
    folder: Path | None = None


def learning_section(run_path: Path, finished: Collection[str], figures: Path) -> LearningSection:
    """Computes the learning tables from the logs, compares, and draws.

    Args:
        run_path: the folder of the run.
        finished: names of its finished stage folders.
        figures: folder for the figures.

    Returns:
        The section; the stages' own results alone where no learning stage has finished.
    """
    written = {name: read_results(run_path / name) for name in finished}
    learnt = [name for name in finished if stage_of(name) in LEARNING_STAGES]
    if not learnt:
        return LearningSection(list(written.values()))
    counting = {*finished, *([_HUMAN] if _USER_STUDY in finished else [])}
    reading = read_logs(
        [folder for folder in evaluation_folders(run_path) if folder.name in counting], cache=run_path / CACHE
    )
    shortest = shortest_ways(reading.evaluations)
    tables = learning_tables(reading.evaluations, shortest)
    found = [
        one
        for name in learnt
        for one in differences(name, written[name], stage_tables(name, reading, shortest), tables)
    ]
    results = with_logs(written.values(), tables)
    said = remarks(found)
    for table, sentence in left_out(reading).items():
        said[table] = f"{said[table]} {sentence}" if table in said else sentence
    material = Material(
        run_path, reading.evaluations, read_curves([run_path / name for name in learnt]), join_sweep(results)
    )
    write_figures(figures, draw_learning(material, figures))
    return LearningSection(results, said, figures)


def left_out(reading: Reading) -> dict[str, str]:
    """Words which logs do not count.

    Args:
        reading: of the run.

    Returns:
        Own table of the stage to a sentence.
    """
    sentences = {}
    for stage in LEARNING_STAGES:
        names = [name for name in reading.left_out if stage_of(name.split("/", 1)[0]) == stage]
        if names:
            some = "; ".join(f"{name} ({_reason(reading.left_out[name], name)})" for name in names[:_SHOWN])
            more = f"; and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            logs = "1 log was" if len(names) == 1 else f"{len(names)} logs were"
            sentences[OWN_TABLES[stage]] = f"{logs} left out: {some}{more}."
    return sentences


def _reason(message: str, name: str) -> str:
    """An error's reason without the path that stands beside it, nor the command that mends it."""
    reason = message.split("; run '", 1)[0]
    return reason.rpartition(f"{name} is ")[2] if f"{name} is " in reason else reason
