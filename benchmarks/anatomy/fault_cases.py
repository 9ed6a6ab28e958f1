"""Cases of a benchmark of faults: each source with each fault in a process of its own, and what comes of them."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

BLOCKED = 0.01  # share of places at half of the aorta's radius and a quarter of others' that may be wall
CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3) / np.sqrt(3)  # of a cube, on a unit ball
NEAR = 3e-3  # m from the true centreline
LEAST_RADIUS = 6e-4  # m


def chosen_faults(parser: argparse.ArgumentParser, options: argparse.Namespace, faults: Collection[str]) -> list[str]:
    """The faults that are asked for; ends the program where one is unknown."""
    chosen: list[str] = options.faults.split(",")
    if unknown := set(chosen) - set(faults):
        parser.error(f"no fault {', '.join(sorted(unknown))}; there are {', '.join(faults)}.")
    return chosen


def arches(options: argparse.Namespace) -> list[str]:
    """Seeds of the arches, as the sources of cases."""
    return [str(options.first + number) for number in range(options.arches)]


def run_cases(script: str, faults: Sequence[str], sources: Sequence[str], further: Sequence[str]) -> None:
    """Runs `script --one SOURCE --faults FAULT` for all cases; prints a line for each, and a JSON object at the end.

    Args:
        further: arguments of every case.
    """
    rows: dict[str, dict[str, Any]] = {}
    for fault in faults:
        for source in sources:
            command = [sys.executable, script, "--one", source, "--faults", fault, *further]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                last = (done.stderr.strip().splitlines() or ["no output"])[-1]
                row: dict[str, Any] = {"right": False, "said": False, "problems": [f"failed: {last}"], "notes": []}
            else:
                row = json.loads(done.stdout.strip().splitlines()[-1])
            rows[f"{fault}, {Path(source).name}"] = row
            outcome = "right" if row["right"] else "said" if row.get("said") else "WRONG"
            print(f"{fault:16s}{Path(source).name:24s}{outcome}", flush=True)
            for problem in row["problems"]:
                print(f"    {problem}", flush=True)
    right = sum(row["right"] for row in rows.values())
    print(json.dumps({"rows": rows, "right": right, "tried": len(rows)}))
