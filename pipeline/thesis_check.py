"""Check of the thesis's sizes: every stage of ``budget=thesis`` in minutes, and a table of what each job took.

``python -m pipeline.thesis_check`` runs the chain with ``experiment=thesis-check``: the networks, images, wires and
actions of the thesis, a handful of updates, episodes and arches. ``stage.device=cuda`` makes it the check of a GPU.
"""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
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
COLUMNS = ("stage", "job", "device", "seconds", "CPU seconds", "peak memory, MB", "of the GPU, MB", "result")
_VERSIONS = ("python", "torch", "stable-baselines3", "mujoco", "numpy")
_EXIT_FAILED = 1

Row = tuple[str, str, str, float | None, float | None, float | None, float | None, str]


def main(overrides: Sequence[str]) -> int:
    """Runs the check, prints its table, and writes it into the run's folder; gives the exit code of a failure, or 0."""
    command = ["python", "-m", "pipeline.thesis_check", *overrides]
    code = run_chain(["all", "--", "budget=thesis", f"experiment={EXPERIMENT}", *overrides])
    run = Path(chosen_value(overrides, "runs_dir", "runs")) / chosen_value(overrides, "name", EXPERIMENT)
    if not run.is_dir():
        return code
    table = rows(run)
    text = markdown(table, shlex.join(command))
    write_text(run / MARKDOWN, text)
    write_json(run / JSON, {"rows": [dict(zip(COLUMNS, row, strict=True)) for row in table], **provenance(command)})
    print(text)  # noqa: T201 - the command's answer
    return code or (0 if all(row[-1] == OK for row in table) else _EXIT_FAILED)


def rows(run: Path) -> list[Row]:
    """What every stage and its jobs took, in the order of the stages."""
    table: list[Row] = []
    for stage in available_stages():
        manifest = read_manifest(run / stage)
        costs = manifest.jobs if manifest is not None else kept_costs(run / stage)
        own = costs.get(OWN_PROCESS)
        if own is None:
            table.append((stage, "", "", None, None, None, None, UNFINISHED))
        else:
            table.append(_row(stage, "", own))
        table += [_row(stage, key, cost) for key, cost in sorted(costs.items()) if key != OWN_PROCESS]
    return table


def _row(stage: str, job: str, cost: Mapping[str, Any]) -> Row:
    numbers = (cost["wall_s"], cost["cpu_s"], cost["memory_mb"], cost["gpu_mb"])
    return (stage, job, str(cost["device"]), *numbers, str(cost["outcome"]))


def provenance(command: Sequence[str]) -> dict[str, Any]:
    """Command, code, versions and machine."""
    return {
        "command": shlex.join(command),
        "commit": present_commit(),
        "versions": software_versions(),
        "machine": {"cores": os.cpu_count(), "architecture": platform.machine(), "system": platform.system()},
    }


def markdown(found: Sequence[Row], command: str) -> str:
    """The table as Markdown, with where it comes from."""
    source = provenance([command])
    versions = ", ".join(f"{name} {source['versions'][name]}" for name in _VERSIONS if name in source["versions"])
    machine = source["machine"]
    lines = [
        f"`{command}`, commit {source['commit']}, {machine['cores']} cores ({machine['architecture']}), {versions}.",
        "",
        "Rows without a job are the stages' own processes; memory counts libraries.",
        "",
        f"| {' | '.join(COLUMNS)} |",
        f"|{'---|' * len(COLUMNS)}",
    ]
    for stage, job, device, *numbers, result in found:
        cells = [
            f"{numbers[0]:.1f}" if numbers[0] is not None else "",
            f"{numbers[1]:.1f}" if numbers[1] is not None else "",
            *("" if value is None else f"{value:.0f}" for value in numbers[2:]),
        ]
        lines.append(f"| {' | '.join((stage, job, device, *cells, result))} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
