"""Tables of the learning stages, computed from their evaluation logs alone: the thesis's, and own ones beside them.

| table               | from                                         | rows                                       |
|---------------------|----------------------------------------------|--------------------------------------------|
| `cathsim_results`   | `baselines`                                  | phantom/row                                |
| `ablation`          | `enn`, the sampling expert, people; Type I   | target/row                                 |
| `imitation`         | `imitation`, I+V+M and V of `enn`; Type I    | target/row                                 |
| `baselines`, `enn`  | the stage of that name, every phantom        | phantom/target/row                         |
| `behaviour_cloning` | `imitation`, every phantom                   | phantom/target/row                         |
| `generalisation`    | `unseen`                                     | row/target/test set                        |
| `expert`, `human`   | only their SPL, by the run's shortest ways   | phantom/target                             |

In the thesis's tables pairs are mean and standard deviation over the deterministic episodes of all seeds, as the thesis
has them. In the own ones they are taken over the training seeds' means, with n - 1 in the denominator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.report.episode_tables import ABLATION_COLUMNS, ABLATION_PHANTOM, ABLATION_TARGETS
from pipeline.report.learning.logs import (
    COMPARED,
    LEARNING_STAGES,
    MODES,
    Evaluation,
    Task,
    evaluation_folders,
    stage_of,
)
from pipeline.report.learning.reading import CACHE, Reading, read_logs
from pipeline.report.learning.statistics import (
    counted,
    of_mode,
    over_seeds,
    shortest_ways,
    summary,
)
from pipeline.report.results import SAMPLES, Table
from pipeline.store.errors import StageError

DETERMINISTIC, STOCHASTIC = MODES
OWN_TABLES = {"baselines": "baselines", "enn": "enn", "imitation": "behaviour_cloning", "unseen": "generalisation"}
BASELINE_COLUMNS = {"reward_{}": "reward", "mean_force_{}_n": "force_n", "max_force_{}_n": "force_max_n"}
OWN_COLUMNS = ("episode_length_steps", "path_length_cm", "spl_pct", "safety_pct", "force_n", "force_p95_n",
               "force_max_n", "contact_force_n")  # fmt: skip
EXPERT_ROW, IMAGE_ROW = "I+V+M", "V"  # of the ablation, which the table of imitation repeats
_ROW_ORDER = ("H", "sampling_expert", "V", "V+M", "I", "I+V", "I+V+M", "ppo_internal", "sac_internal", "ppo_image",
              "sac_image", "ppo_sequential", "sac_sequential", "path_follower", "image_w_enn")  # fmt: skip

Rows = dict[tuple[str, str, str, str], list[Evaluation]]  # stage, phantom, target, row -> its evaluations


def tables_from_logs(source: Path | Sequence[Evaluation], *, cache: Path | None = None) -> dict[str, Table]:
    """Computes the tables of a run, of one stage, or of evaluations that are at hand.

    Args:
        source: folder of a run, folder of a learning stage in a run, or evaluations. SPL's shortest ways are taken over
            every episode of the run, or over the evaluations given.
        cache: file that remembers the metrics of logs; by default one in the run.

    Returns:
        table -> row -> column -> cell; no table without evaluations.

    Raises:
        StageError: a stage's folder holds no evaluation that can be used.
    """
    if not isinstance(source, Path):
        return learning_tables(source, shortest_ways(source))
    is_stage = stage_of(source.name) in LEARNING_STAGES and not evaluation_folders(source)
    run_path = source.parent if is_stage else source
    reading = read_logs(evaluation_folders(run_path), cache=cache or run_path / CACHE)
    shortest = shortest_ways(reading.evaluations)
    if not is_stage:
        return learning_tables(reading.evaluations, shortest)
    tables = stage_tables(source.name, reading, shortest)
    if not tables:
        lost = [name for name in reading.left_out if name.startswith(f"{source.name}/")]
        raise StageError(
            f"{source} holds no evaluation to make a table of"
            + (
                f", {len(lost)} logs cannot be used, the first is {lost[0]} ({reading.left_out[lost[0]]})"
                if lost
                else ""
            )
            + f": run stage {stage_of(source.name)} again with force=true"
        )
    return tables


def stage_tables(folder: str, reading: Reading, shortest: Mapping[Task, float]) -> dict[str, Table]:
    """The tables of one stage folder, by the shortest ways of its run.

    Args:
        folder: its name, e.g. `enn@seed=1`.
        reading: of the run.
        shortest: likewise.

    Returns:
        table -> row -> column -> cell.
    """
    own = [one for one in reading.evaluations if one.folder == folder]
    tables = learning_tables(own, shortest)
    if "imitation" in tables:  # it repeats rows of the ablation
        beside = [one for one in reading.evaluations if one.stage == "enn"]
        tables["imitation"] = learning_tables([*own, *beside], shortest)["imitation"]
    return tables


def learning_tables(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Table]:
    """Computes every table that the evaluations have something for.

    Args:
        evaluations: of any stages.
        shortest: from `shortest_ways`.

    Returns:
        table -> row -> column -> cell.
    """
    rows = named_rows(evaluations)
    tables = {
        "cathsim_results": _baselines(rows, shortest),
        "ablation": _ablation(rows, shortest),
        "imitation": _imitation(rows, shortest),
        **{table: _own(rows, stage, shortest) for stage, table in OWN_TABLES.items()},
        **{stage: _spl_alone(rows, stage, shortest) for stage in COMPARED},
    }
    return {name: table for name, table in tables.items() if table}


def named_rows(evaluations: Sequence[Evaluation]) -> Rows:
    """Groups evaluations by stage, phantom (or test set of the stage `unseen`), target and row.

    A row trained in several variants gives several rows: the plain name goes to the thesis's variant, or where that has
    not run to desk's; others, and whatever else a sweep changed, carry their variant in brackets. One trained with
    several weights of the force gives a row for each weight.

    Args:
        evaluations: of any stages; demonstrations belong to no row.

    Returns:
        The groups, ordered as the tables show them.
    """
    variants: dict[tuple[str, str], set[str]] = {}
    weights: dict[tuple[str, str], set[float]] = {}
    for one in counted(evaluations):
        variants.setdefault((one.stage, one.row), set()).add(one.variant)
        if one.force_weight is not None:
            weights.setdefault((one.stage, one.row), set()).add(one.force_weight)
    plain = {key: _plain_variant(of_row) for key, of_row in variants.items()}
    rows: Rows = {}
    for one in counted(_comparable(evaluations)):
        name = one.row
        if one.force_weight is not None and len(weights[one.stage, one.row]) > 1:
            name += f" {one.force_weight:g}"
        if one.variant != plain[one.stage, one.row]:
            name += f" ({one.variant})".replace("/", "·")
        place = one.test_set.replace("/", "·") if one.stage == "unseen" else one.phantom
        rows.setdefault((one.stage, place, one.target, name), []).append(one)
    return dict(sorted(rows.items(), key=lambda item: (*item[0][:3], row_place(item[0][3]), item[0][3])))


def _plain_variant(variants: set[str]) -> str | None:
    """The variant whose rows need no brackets; None where none stands out."""
    return next(
        (name for name in ("thesis", "desk") if name in variants), min(variants) if len(variants) == 1 else None
    )


def _comparable(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Leaves out people's episodes under another limit, wire, start or radius than the policies' of the same vessel."""
    asked = {(one.task, one.max_steps) for one in evaluations if one.stage in ("enn", "expert")}
    return [one for one in evaluations if one.stage != "human" or not asked or (one.task, one.max_steps) in asked]


def row_place(row: str) -> int:
    """Where a row stands among the others: the thesis's order, then the rest."""
    return next((index for index, known in enumerate(_ROW_ORDER) if row == known), len(_ROW_ORDER))


def _baselines(rows: Rows, shortest: Mapping[Task, float]) -> Table:
    table: dict[str, Any] = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        chosen = of_mode(evaluations, DETERMINISTIC)
        if stage != "baselines" or target not in ABLATION_TARGETS or not chosen:
            continue
        values = summary(chosen, shortest).as_dict()
        row = table.setdefault(f"{phantom}/{name}", {})
        row |= {column.format(target): values[source] for column, source in BASELINE_COLUMNS.items()}
        row[f"success_{target}_pct"] = _mean(values["success_pct"])
        row[SAMPLES] = min(len(chosen), row.get(SAMPLES, len(chosen)))  # behind either target's cells
    return table


def _ablation(rows: Rows, shortest: Mapping[Task, float]) -> Table:
    table: Table = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        if stage in ("enn", *COMPARED) and phantom == ABLATION_PHANTOM and target in ABLATION_TARGETS:
            table |= _episode_row(f"{target}/{name}", evaluations, shortest)
    return table


def _imitation(rows: Rows, shortest: Mapping[Task, float]) -> Table:
    table: Table = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        if phantom != ABLATION_PHANTOM or target not in ABLATION_TARGETS:
            continue
        repeated = {EXPERT_ROW: "enn", IMAGE_ROW: "image_wo_enn"}.get(name) if stage == "enn" else None
        if stage == "imitation" or repeated:
            table |= _episode_row(f"{target}/{repeated or name}", evaluations, shortest)
    return table if any(stage == "imitation" for stage, *_ in rows) else {}


def _episode_row(key: str, evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> Table:
    """A row in the columns of the thesis's ablation; none without deterministic episodes."""
    chosen = of_mode(evaluations, DETERMINISTIC)
    if not chosen:
        return {}
    values: dict[str, Any] = {**summary(chosen, shortest).as_dict(), SAMPLES: len(chosen)}
    return {key: {column: values[column] for column in ABLATION_COLUMNS}}


def _own(rows: Rows, stage: str, shortest: Mapping[Task, float]) -> Table:
    table: Table = {}
    for (of_stage, place, target, name), evaluations in rows.items():
        if of_stage == stage:
            key = f"{name}/{target}/{place}" if stage == "unseen" else f"{place}/{target}/{name}"
            table[key] = _own_row(evaluations, shortest)
    return dict(sorted(table.items(), key=lambda item: item[0].rpartition("/")[0])) if stage == "unseen" else table


def _own_row(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Any]:
    from cathsim.metrics.intervals import wilson_interval

    fixed, drawn = of_mode(evaluations, DETERMINISTIC), of_mode(evaluations, STOCHASTIC)
    row: dict[str, Any] = {}
    if fixed:
        values = over_seeds(fixed, shortest)
        low, high = wilson_interval(sum(one.metrics.success for one in fixed), len(fixed))
        row = {"success_pct": values["success_pct"], "success_low_pct": 100 * low, "success_high_pct": 100 * high}
    if drawn:
        row["stochastic_success_pct"] = over_seeds(drawn, shortest)["success_pct"]
    if fixed:
        row |= {column: values[column] for column in OWN_COLUMNS}
        row["force_largest_n"] = max(one.metrics.force_max for one in fixed)
    row["seeds"] = len({one.training_seed for one in evaluations})
    row[SAMPLES] = len(fixed)
    return row


def _spl_alone(rows: Rows, stage: str, shortest: Mapping[Task, float]) -> Table:
    return {
        f"{phantom}/{target}": {"spl_pct": summary(evaluations, shortest).spl_pct}
        for (of_stage, phantom, target, _), evaluations in rows.items()
        if of_stage == stage
    }


def _mean(cell: Any) -> float:
    return float(cell[0] if isinstance(cell, list) else cell)
