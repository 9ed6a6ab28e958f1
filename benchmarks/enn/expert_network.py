"""Benchmark of the Expert Navigation Network: from nothing to evaluated policies for both targets of one arch.

    python benchmarks/enn/expert_network.py [--phantom type_1] [--seeds 3] [--quick]

Runs the stages phantoms, expert and enn (I+V+M at budget desk) in an empty folder, two trainings at a time where there
are two cores, and prints the time of each, the table of policies, and one JSON object as its last line. The anatomy's
grid comes from the cache where there is one. `--quick` runs budget smoke: its success means nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

STAGES = ("phantoms", "expert", "enn")
EXPERT = "I+V+M"
COLUMNS = ("success_pct", "stochastic_success_pct", "spl_pct", "safety_pct", "force_p95_n", "force_max_n",
           "episode_length_steps", "path_length_cm", "n")  # fmt: skip


def run_stage(stage: str, folder: Path, settings: list[str]) -> float:
    """Runs a stage and returns its seconds; a stage that fails ends the benchmark with its own message."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "pipeline", f"stage={stage}", f"runs_dir={folder}", "name=benchmark", *settings]
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    finished = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if finished.returncode:
        raise SystemExit(finished.stderr.strip() or finished.stdout.strip())
    return time.perf_counter() - began


def main() -> None:
    """Prints times, table and JSON."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--phantom", default="type_1", help="the arch")
    parser.add_argument("--seeds", type=int, default=3, help="trainings a target")
    parser.add_argument("--quick", action="store_true", help="budget smoke, one target")
    arguments = parser.parse_args()
    budget, phantom = ("smoke" if arguments.quick else "desk"), arguments.phantom
    of_stage: dict[str, list[str]] = {
        "phantoms": [f"stage.phantoms=[{phantom}]"],
        "expert": [f"stage.phantoms=[{phantom}]", "stage.film=false"],
        "enn": [f"stage.phantoms=[{phantom}]", f"modality={EXPERT}", "stage.safe_weights=[]",
                "stage.expert_episodes=0", f"stage.seeds={1 if arguments.quick else arguments.seeds}"],
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        seconds = {
            stage: run_stage(stage, Path(folder), [f"budget={budget}", *settings])
            for stage, settings in of_stage.items()
        }
        results: dict[str, Any] = json.loads((Path(folder) / "benchmark/enn/results.json").read_text(encoding="utf-8"))
    for stage in STAGES:
        print(f"{stage:10} {seconds[stage]:8.1f} s")
    print(f"{'together':10} {sum(seconds.values()):8.1f} s\n")
    rows = {name: {key: row.get(key) for key in COLUMNS} for name, row in results["enn"].items()}
    for name, row in rows.items():
        print(f"{name:22} " + "  ".join(f"{key} {_shown(value)}" for key, value in row.items()))
    print(json.dumps({"budget": budget, "seconds": {**seconds, "together": sum(seconds.values())}, "enn": rows}))


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f"{value[0]:.3g} ({value[1]:.2g})"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
