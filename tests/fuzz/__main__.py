"""A fuzz of everything that reads files or words of others: ``python -m tests.fuzz --seconds 600 --seed 0``.

Every target gets its share of the time. A case fails when it ends in anything but the promised error, when damaged
data are taken for whole ones, or when it takes too long or too much memory. The summary is JSON; each failure says how
to repeat it. Exit codes: 0 nothing failed, 1 something did, 2 wrong usage.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from pathlib import Path
from typing import Any

from tests.fuzz.target import Target

os.environ.setdefault("OMP_NUM_THREADS", "1")


def targets() -> dict[str, type[Target]]:
    """All targets by name; importing them takes seconds."""
    from tests.fuzz.data_set_target import DataSetTarget
    from tests.fuzz.device_target import DeviceTarget
    from tests.fuzz.dicom_target import DicomTarget
    from tests.fuzz.log_target import LogTarget
    from tests.fuzz.mesh_target import MeshTarget
    from tests.fuzz.model_targets import CheckpointTarget, ModelTarget
    from tests.fuzz.run_folder_target import RunFolderTarget
    from tests.fuzz.text_targets import ConsoleTarget, SettingsTarget

    kinds = (LogTarget, ModelTarget, CheckpointTarget, RunFolderTarget, DataSetTarget, DeviceTarget, DicomTarget,
             SettingsTarget, ConsoleTarget, MeshTarget)  # fmt: skip
    return {kind.name: kind for kind in kinds}


def main(arguments: list[str]) -> int:
    """Runs the command line; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="for all targets together (default %(default)g)")
    parser.add_argument("--seed", type=int, default=0, help="the first one (default %(default)s)")
    parser.add_argument("--output", type=Path, help="file of the JSON summary; the standard output when left out")
    parser.add_argument("--only", metavar="NAMES", help="targets, separated by commas")
    parser.add_argument("--case", type=int, metavar="SEED", help="run one seed of the targets, and nothing else")
    options = parser.parse_args(arguments)
    from tests.fuzz.runner import run_target

    kinds = targets()
    chosen = options.only.split(",") if options.only else list(kinds)
    unknown = [name for name in chosen if name not in kinds]
    if unknown:
        parser.error(f"unknown target {unknown[0]!r}: choose from {', '.join(kinds)}")
    shares = sum(kinds[name].share for name in chosen)
    summary: dict[str, Any] = {"seed": options.seed, "seconds": options.seconds, "targets": {}}
    for name in chosen:
        seconds = options.seconds * kinds[name].share / shares
        seeds = None if options.case is None else [options.case]
        tally = run_target(kinds[name], options.seed, seconds=seconds, seeds=seeds)
        summary["targets"][name] = tally.to_json()
        verdicts = ", ".join(f"{count} {verdict}" for verdict, count in sorted(tally.verdicts.items()))
        line = f"{tally.cases} cases in {tally.seconds:.0f} s, {verdicts}, slowest {tally.slowest_s:.2f} s"
        print(f"{name}: {line}, {len(tally.failures)} failed", file=sys.stderr, flush=True)
        for failure in tally.failures:
            print(f"  seed {failure['seed']}: {failure['problem']} ({failure['where']})", file=sys.stderr, flush=True)
    results = summary["targets"].values()
    summary["cases"] = sum(result["cases"] for result in results)
    summary["failed"] = sum(len(result["failures"]) for result in results)
    text = json.dumps(summary, indent=2) + "\n"
    if options.output is None:
        print(text, end="")
    else:
        options.output.write_text(text, encoding="utf-8")
    return 1 if summary["failed"] else 0


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    sys.exit(main(sys.argv[1:]))
