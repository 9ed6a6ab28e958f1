"""Tables of the learning stages, computed from their evaluation logs alone: the thesis's, and own ones beside them.

| table               | from                                         | rows                                       |
|---------------------|----------------------------------------------|--------------------------------------------|
| `cathsim_results`   | `baselines`                                  | phantom/row                                |
| `ablation`          | `enn`, the sampling expert, people; Type I   | target/row                                 |
| `imitation`         | `imitation`, I+V+M and V of `enn`; Type I    | target/row                                 |
| `baselines`, `enn`  | the stage of that name, every phantom        | phantom/target/row                         |
| `behaviour_cloning` | `imitation`, every phantom                   | phantom/target/row                         |
| `generalisation`    | `unseen`                                     | row/target/test set                        |
| `expert`, `human`   | the sampling expert, people; every phantom   | phantom/target                             |
| `devices`           | every stage above, where there are catheters | phantom/target/stage/row/device            |
| `load_cell`         | every stage above whose logs hold the forces | phantom/target/device/stage/row            |

In the thesis's tables, `expert` and `human`, pairs are mean and standard deviation over the deterministic episodes of
all seeds, as the thesis has them. In the other own ones they are taken over the training seeds' means, with n - 1 in
the denominator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluations.forces import QUANTITIES, WIRE
from pipeline.evaluations.logs import (
    COMPARED,
    DEMONSTRATION,
    DETERMINISTIC,
    LEARNING_STAGES,
    STOCHASTIC,
    Evaluation,
    Task,
    evaluation_folders,
    read_logs,
)
from pipeline.tables import SAMPLES, Cell, Table, mean_of

OWN_TABLES = {"baselines": "baselines", "enn": "enn", "imitation": "behaviour_cloning", "unseen": "generalisation",
              "expert": "expert", "human": "human"}  # fmt: skip
BASELINE_COLUMNS = {"reward_{}": "reward", "mean_force_{}_n": "force_n", "max_force_{}_n": "force_max_n"}
THESIS_PHANTOM, THESIS_TARGETS = "type_1", ("bca", "lcca")  # of the thesis's ablation
ABLATION_COLUMNS = ("force_n", "path_length_cm", "episode_length_steps", "safety_pct", "success_pct", "spl_pct",
                    "success_lumen_pct", "depth_mm")  # fmt: skip
OWN_COLUMNS = ("success_lumen_pct", "depth_mm", "episode_length_steps", "path_length_cm", "spl_pct", "safety_pct",
               "force_n", "force_p95_n", "force_max_n", "contact_force_n")  # fmt: skip
EXPERT_ROW = "I+V+M"
_DEVICE_COLUMNS = ("success_pct", "episode_length_steps", "path_length_cm", "force_n", "force_max_n")
_DEVICES = ("wire", "catheter")  # as `Evaluation.feeder_forces` has them
_REPEATED = {EXPERT_ROW: "enn", "V": "image_wo_enn"}  # rows of the ablation in the table of imitation
MISREGISTERED = "misregistered"  # test sets of unseen arches in which the roadmap is displaced: a group of their own
_ROW_ORDER = ("H", "sampling_expert", "V", "V+M", "I", "I+V", "I+V+M", "ppo_internal", "sac_internal", "ppo_image",
              "sac_image", "ppo_sequential", "sac_sequential", "path_follower", "image_w_enn")  # fmt: skip

Rows = dict[tuple[str, str, str, str], list[Evaluation]]  # stage, phantom, target, row -> its evaluations
Shortest = Mapping[Task, float]


def tables_from_logs(run_path: Path) -> dict[str, Table]:
    """Computes the tables of a run; SPL's shortest paths are those of all of it."""
    evaluations = read_logs(evaluation_folders(run_path)).evaluations
    return learning_tables(evaluations, shortest_paths(evaluations))


def learning_tables(evaluations: Sequence[Evaluation], shortest: Shortest) -> dict[str, Table]:
    """Computes every table (row -> column -> cell) that the evaluations have something for."""
    rows = named_rows(evaluations)
    deterministic = {key: of_mode(chosen, DETERMINISTIC) for key, chosen in rows.items()}
    tables = {
        "cathsim_results": _baselines(rows, shortest),
        "ablation": _thesis(rows, shortest, _in_ablation),
        "imitation": _thesis(rows, shortest, _in_imitation) if any(stage == "imitation" for stage, *_ in rows) else {},
        **{OWN_TABLES[stage]: _own(rows, stage, shortest) for stage in LEARNING_STAGES},
        **{OWN_TABLES[stage]: _of_operator(rows, stage, shortest) for stage in COMPARED},
        "devices": device_table(deterministic, shortest),
        "load_cell": load_cell_table(deterministic),
    }
    return {name: table for name, table in tables.items() if table}


def named_rows(evaluations: Sequence[Evaluation]) -> Rows:
    """Groups evaluations by stage, phantom (or test set of the stage `unseen`), target and row.

    A row trained in several variants gives several rows: the plain name goes to the thesis's variant, or where that has
    not run to desk's; others, and whatever else a sweep changed, carry their variant in brackets. One trained with
    several weights of the force gives a row for each weight, and each catheter one of its own, in brackets, too.
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
        if one.variant and one.variant != plain[one.stage, one.row]:
            name += f" ({one.variant})".replace("/", "·")
        name = with_device(name, one.device)
        place = one.test_set.replace("/", "·") if one.stage == "unseen" else one.phantom
        rows.setdefault((one.stage, place, one.target, name), []).append(one)
    return dict(sorted(rows.items(), key=lambda item: (*item[0][:3], row_place(item[0][3]), item[0][3])))


def _plain_variant(variants: set[str]) -> str | None:
    """The variant whose rows need no brackets; None where none stands out."""
    return next(
        (name for name in ("thesis", "desk") if name in variants), min(variants) if len(variants) == 1 else None
    )


def _comparable(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Keeps of people's episodes in a vessel those under the policies' limit, wire, start and radius, if there are."""
    policy_limits = {(one.task, one.max_steps) for one in evaluations if one.stage in ("enn", "expert")}
    human = [one for one in evaluations if one.stage == "human"]
    same = {one.log: (one.phantom, one.target) for one in human if (one.task, one.max_steps) in policy_limits}
    vessels = set(same.values())
    return [
        one
        for one in evaluations
        if one.stage != "human" or one.log in same or (one.phantom, one.target) not in vessels
    ]


def row_place(row: str) -> int:
    """Where a row stands among the others: the thesis's order, then the rest."""
    return next((index for index, known in enumerate(_ROW_ORDER) if row == known), len(_ROW_ORDER))


def _baselines(rows: Rows, shortest: Shortest) -> Table:
    table: dict[str, Any] = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        chosen = of_mode(evaluations, DETERMINISTIC)
        if stage != "baselines" or target not in THESIS_TARGETS or not chosen:
            continue
        values = summary(chosen, shortest)
        row = table.setdefault(f"{phantom}/{name}", {})
        row |= {column.format(target): values[source] for column, source in BASELINE_COLUMNS.items()}
        row[f"success_{target}_pct"] = mean_of(values["success_pct"])
        if values["success_lumen_pct"] is not None:
            row[f"success_lumen_{target}_pct"] = mean_of(values["success_lumen_pct"])
        row[SAMPLES] = min(len(chosen), row.get(SAMPLES, len(chosen)))  # behind either target's cells
    return table


def _in_ablation(stage: str, row: str) -> str | None:
    """What a stage's row is called in the thesis's ablation; None where it does not stand there."""
    return row if stage in ("enn", *COMPARED) else None


def _in_imitation(stage: str, row: str) -> str | None:
    """What a stage's row is called in the thesis's table of imitation, which repeats two of the ablation."""
    return row if stage == "imitation" else _REPEATED.get(row) if stage == "enn" else None


def _thesis(rows: Rows, shortest: Shortest, named: Callable[[str, str], str | None]) -> Table:
    """The columns of the thesis's ablation for every row with a name there and with deterministic episodes."""
    table: Table = {}
    for (stage, phantom, target, row), evaluations in rows.items():
        name, chosen = named(stage, row), of_mode(evaluations, DETERMINISTIC)
        if name and chosen and phantom == THESIS_PHANTOM and target in THESIS_TARGETS:
            values = summary(chosen, shortest)
            cells = {column: values[column] for column in ABLATION_COLUMNS}
            table[f"{target}/{name}"] = {**cells, SAMPLES: len(chosen)}
    return table


def _own(rows: Rows, stage: str, shortest: Shortest) -> Table:
    table: Table = {}
    for (of_stage, place, target, name), evaluations in rows.items():
        if of_stage == stage:
            if stage == "unseen":
                group = f"{name}_{MISREGISTERED}" if place.startswith(MISREGISTERED) else name
                key = f"{group}/{target}/{place}"
            else:
                key = f"{place}/{target}/{name}"
            table[key] = _own_row(evaluations, shortest)
    return dict(sorted(table.items(), key=lambda item: item[0].rpartition("/")[0])) if stage == "unseen" else table


def _own_row(evaluations: Sequence[Evaluation], shortest: Shortest) -> dict[str, Any]:
    from cathsim.metrics.episodes import wilson_interval

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


def _of_operator(rows: Rows, stage: str, shortest: Shortest) -> Table:
    """Every metric of the sampling expert's or people's episodes."""
    table: Table = {}
    for (of_stage, phantom, target, name), evaluations in rows.items():
        if of_stage == stage:
            values = summary(evaluations, shortest)
            samples = values.pop("episodes")
            further = name.removeprefix(COMPARED[stage][1])  # variant and devices, in brackets
            table[f"{phantom}/{target}{further}"] = {**values, SAMPLES: samples}
    return table


def with_device(row: str, device: str) -> str:
    """A row's name, with the catheter in brackets where there is one."""
    return row if device == WIRE else f"{row} ({device})"


def without_device(row: str, device: str) -> str:
    """What `with_device` was given."""
    return row.removesuffix(with_device("", device))


def device_table(rows: Rows, shortest: Shortest) -> Table:
    """Row ``phantom/target/stage/row/device`` to means and spreads; none where all steered the wire alone."""
    lines: dict[tuple[str, str, str, str], dict[str, Sequence[Evaluation]]] = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        if evaluations:
            device = evaluations[0].device
            operator = phantom, target, stage, without_device(name, device)
            lines.setdefault(operator, {})[device] = evaluations
    return {
        "/".join((*operator, device)): _device_row(evaluations, shortest)
        for operator, devices in lines.items()
        if set(devices) != {WIRE}
        for device, evaluations in sorted(devices.items(), key=lambda item: (item[0] != WIRE, item[0]))
    }


def _device_row(evaluations: Sequence[Evaluation], shortest: Shortest) -> dict[str, Any]:
    values = summary(evaluations, shortest)
    cells: dict[str, Any] = {column: values[column] for column in _DEVICE_COLUMNS}
    pushed = [one.feeder_forces for one in evaluations if one.feeder_forces is not None]
    for index, device in enumerate(_DEVICES if pushed else ()):
        means, largest = [one[0][index] for one in pushed], [one[1][index] for one in pushed]
        cells[f"{device}_feeder_n"] = [float(np.mean(means)), float(np.std(means))]
        cells[f"{device}_feeder_max_n"] = float(max(largest))
    return {**cells, SAMPLES: len(evaluations)}


def load_cell_table(rows: Rows) -> Table:
    """Mean and standard deviation over all steps of every operator, by phantom, target and device."""
    table: Table = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        for device in sorted({one.device for one in evaluations}):
            chosen = [one for one in evaluations if one.device == device and one.wall_forces is not None]
            if not chosen:
                continue
            weights = np.array([one.metrics.steps for one in chosen], float)
            cells: dict[str, Any] = {SAMPLES: len(chosen)}
            for quantity in QUANTITIES:
                moments = np.array([(one.wall_forces or {})[quantity] for one in chosen])
                mean, square = np.average(moments, axis=0, weights=weights)
                cells[quantity] = [float(mean), float(np.sqrt(max(square - mean**2, 0.0)))]
            table[f"{phantom}/{target}/{device}/{stage}/{without_device(name, device)}"] = cells
    return table


def shortest_paths(evaluations: Sequence[Evaluation]) -> dict[Task, float]:
    """Finds the shortest path by which any successful episode reached each target: the optimum of SPL for all policies.

    Source: thesis, section Evaluation Metrics, SPL.
    """
    shortest: dict[Task, float] = {}
    for one in evaluations:
        if one.metrics.success:
            shortest[one.task] = min(one.metrics.path_length, shortest.get(one.task, math.inf))
    return shortest


def summary(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Any]:
    """Mean and spread over episodes (at least one), by the columns of `cathsim.metrics.Summary`; SPL by task."""
    from cathsim.metrics import summarise

    optimal = [shortest.get(one.task, math.nan) for one in evaluations]
    return summarise([one.metrics for one in evaluations], shortest=optimal).as_dict()


def over_seeds(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Cell]:
    """Means over the training seeds' means, with standard deviation (n - 1) of several; None without values."""
    seeds: dict[int, list[Evaluation]] = {}
    for one in evaluations:
        seeds.setdefault(one.training_seed, []).append(one)
    means: dict[str, list[float]] = {}
    for of_seed in seeds.values():
        for name, value in summary(of_seed, shortest).items():
            if value is not None:
                means.setdefault(name, []).append(mean_of(value))
        contacts = [one.contact_force for one in of_seed if one.contact_force is not None]
        if contacts:
            means.setdefault("contact_force_n", []).append(float(np.mean(contacts)))
    unknown = dict.fromkeys(("contact_force_n", "success_lumen_pct", "depth_mm"))
    return {**unknown, **{name: _mean_and_spread(values) for name, values in means.items()}}


def _mean_and_spread(values: list[float]) -> Cell:
    mean = float(np.mean(values))
    return [mean, float(np.std(values, ddof=1))] if len(values) > 1 else mean


def of_mode(evaluations: Sequence[Evaluation], mode: str) -> list[Evaluation]:
    """Those of one mode, "deterministic" or "stochastic"."""
    return [one for one in evaluations if one.mode == mode]


def counted(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Those that belong to a row: all but demonstrations."""
    return [one for one in evaluations if one.mode != DEMONSTRATION]
