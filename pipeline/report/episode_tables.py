"""Tables of recorded episodes: every metric by task, and the thesis's columns for its ablation table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cathsim.metrics import EpisodeMetrics

ABLATION_PHANTOM = "type_1"  # that of the thesis's ablation table
ABLATION_TARGETS = ("bca", "lcca")
ABLATION_COLUMNS = ("force_n", "path_length_cm", "episode_length_steps", "safety_pct", "success_pct", "spl_pct", "n")


def episode_tables(
    episodes: Mapping[str, Sequence[EpisodeMetrics]], *, own: str, operator: str
) -> dict[str, dict[str, dict[str, Any]]]:
    """Sums episodes up.

    Args:
        episodes: task ("type_1/bca") to its episodes, at least one each.
        own: name of the table with every metric.
        operator: the row of the ablation table, e.g. "H".

    Returns:
        Table to row to column to cell; the ablation only where there is something for it.
    """
    from cathsim.metrics import summarise

    metrics: dict[str, dict[str, Any]] = {}
    ablation: dict[str, dict[str, Any]] = {}
    for task, of_task in episodes.items():
        row = summarise(of_task).as_dict()
        row["n"] = row.pop("episodes")
        metrics[task] = row
        phantom, target = task.split("/")
        if phantom == ABLATION_PHANTOM and target in ABLATION_TARGETS:
            ablation[f"{target}/{operator}"] = {column: row[column] for column in ABLATION_COLUMNS}
    tables = {own: metrics} if metrics else {}
    return {**tables, "ablation": ablation} if ablation else tables
