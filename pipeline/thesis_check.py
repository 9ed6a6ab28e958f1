"""Check of the thesis's sizes: every stage of ``budget=thesis`` in minutes, and a table of what each job took.

``python -m pipeline.thesis_check`` runs the chain with ``experiment=thesis-check``: the networks, images, wires and
actions of the thesis, a handful of updates, episodes and arches. ``stage.device=cuda`` makes it the check of a GPU.
"""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.chain import main as run_chain
from pipeline.settings.quoting import chosen_value
from pipeline.stages import available_stages
from pipeline.store.atomic_files import write_json, write_text
from pipeline.store.costs import OK, OWN_PROCESS, kept_costs
from pipeline.store.manifest import read_manifest
from pipeline.store.provenance import present_commit, software_versions

EXPERIMENT = "thesis-check"
JSON, MARKDOWN = "thesis_check.json", "thesis_check.md"
UNFINISHED = "did not finish"
# fields of a `pipeline.store.costs.Cost` to columns of the table, behind stage and job
COLUMNS = {"device": "device", "wall_s": "seconds", "cpu_s": "CPU seconds", "memory_mb": "peak memory, MB",
           "gpu_mb": "of the GPU, MB", "outcome": "result"}  # fmt: skip
_VERSIONS = ("python", "torch", "stable-baselines3", "mujoco", "numpy")
_EXIT_FAILED = 1

Row = dict[str, Any]


def main(overrides: Sequence[str]) -> int:
    """Runs the check, prints its table, and writes it into the run's folder; gives the exit code of a failure, or 0."""
    code = run_chain(["all", "--", "budget=thesis", f"experiment={EXPERIMENT}", *overrides])
    run = Path(chosen_value(overrides, "runs_dir", "runs")) / chosen_value(overrides, "name", EXPERIMENT)
    if not run.is_dir():
        return code
    found: dict[str, Any] = {
        "rows": rows(run),
        "command": shlex.join(["python", "-m", "pipeline.thesis_check", *overrides]),
        "commit": present_commit(),
        "versions": software_versions(),
        "machine": {"cores": os.cpu_count(), "architecture": platform.machine(), "system": platform.system()},
    }
    text = markdown(found)
    write_text(run / MARKDOWN, text)
    write_json(run / JSON, found)
    print(text)  # noqa: T201 - the command's answer
    return code or (0 if all(row["result"] == OK for row in found["rows"]) else _EXIT_FAILED)


def rows(run: Path) -> list[Row]:
    """What every stage and its jobs took, in the order of the stages; a stage's own process has no job."""
    table: list[Row] = []
    for stage in available_stages():
        manifest = read_manifest(run / stage)
        costs = manifest.jobs if manifest is not None else kept_costs(run / stage)
        if OWN_PROCESS not in costs:
            table.append({"stage": stage, "job": "", "result": UNFINISHED})
        for job, cost in sorted(costs.items()):
            table.append({"stage": stage, "job": job, **{COLUMNS[name]: cost[name] for name in COLUMNS}})
    return table


def markdown(found: dict[str, Any]) -> str:
    """The table as Markdown, with where it comes from."""
    versions = ", ".join(f"{name} {found['versions'][name]}" for name in _VERSIONS if name in found["versions"])
    machine, columns = found["machine"], ("stage", "job", *COLUMNS.values())
    lines = [
        f"`{found['command']}`, commit {found['commit']}, {machine['cores']} cores ({machine['architecture']}), "
        f"{versions}.",
        "",
        "Rows without a job are the stages' own processes; memory counts libraries.",
        "",
        f"| {' | '.join(columns)} |",
        f"|{'---|' * len(columns)}",
        *(f"| {' | '.join(_cell(column, row.get(column, '')) for column in columns)} |" for row in found["rows"]),
    ]
    return "\n".join(lines) + "\n"


def _cell(column: str, value: Any) -> str:
    return str(value) if isinstance(value, str) else f"{value:.0f}" if column.endswith("MB") else f"{value:.1f}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
