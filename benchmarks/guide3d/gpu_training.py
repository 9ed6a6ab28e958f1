"""One training on the CPU, on a GPU in mixed precision, by two processes, and interrupted on one and ended elsewhere.

    python benchmarks/guide3d/gpu_training.py DATASET --output FOLDER [--networks unet spherical] [--size desk]
        [--epochs 4] [--device cuda] [--places cpu gpu continued two] [--quick]

Each runs `guide3d.train` on the data set with the same seed. The two processes are those of torchrun; as they share a
GPU, which NCCL refuses, they exchange gradients by gloo. Prints a table of losses by epoch (trained, validated) and
wall seconds of the epochs after the first, and in its last line a JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from torch import distributed

from guide3d.learning.training import FitProgress
from guide3d.train import arguments, main, train

ROOT = Path(__file__).resolve().parents[2]
PLACES = ("cpu", "gpu", "continued", "two")
_AS_RANK = "--as-rank"


class _Interruption(Exception):
    """The training is stopped here."""


def trained(words: list[str], stop_after: int | None = None) -> dict[str, Any] | None:
    """Losses by epoch and wall time of a training in this process; None where it was interrupted."""
    ends: list[float] = [time.perf_counter()]

    def progress(now: FitProgress) -> None:
        ends.append(time.perf_counter())
        if now.epoch == stop_after:
            raise _Interruption

    try:
        table = train(arguments(words), progress)
    except _Interruption:
        return None
    return summary(table, ends[-1] - ends[1], len(ends) - 2)


def by_two_processes(words: list[str], output: Path) -> dict[str, Any]:
    """The same by torchrun; both processes take the first GPU."""
    command = [
        sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2",
        str(Path(__file__).resolve()), _AS_RANK, *words,
    ]  # fmt: skip
    before = time.perf_counter()
    subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    wall = time.perf_counter() - before
    table = json.loads((output / "training.json").read_text(encoding="utf-8"))
    return summary(table, wall, len(table["rows"]))


def summary(table: dict[str, Any], seconds: float, epochs: int) -> dict[str, Any]:
    """Losses of the rows, and wall seconds of an epoch."""
    return {
        "processes": table["processes"],
        "loss": [round(row["loss"], 5) for row in table["rows"]],
        "validation": [row["validation"] and round(row["validation"], 5) for row in table["rows"]],
        "epoch_s": round(seconds / epochs, 3) if epochs else None,
    }


def compared(network: str, asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """All trainings of a network."""
    found: dict[str, dict[str, Any]] = {}

    def words(name: str, device: str, epochs: int) -> list[str]:
        return [
            str(asked.data), "--network", network, "--size", asked.size, "--epochs", str(epochs), "--device", device,
            "--output", str(asked.output / network / name), "--pictures", str(asked.output / "pictures"),
        ]  # fmt: skip

    for place in PLACES[:2] if asked.quick else asked.places:
        device = "cpu" if place == "cpu" else asked.device
        if place == "continued":
            trained(words(place, device, asked.epochs), asked.epochs // 2)
            device = "cpu"
        if place == "two":
            found[place] = by_two_processes(words(place, device, asked.epochs), asked.output / network / place)
        else:
            found[place] = trained(words(place, device, asked.epochs)) or {}
        told(network, place, found[place])
    return found


def told(network: str, name: str, row: dict[str, Any]) -> None:
    """Prints a row."""
    losses = " ".join(f"{loss:.4f}" for loss in row["loss"])
    validation = " ".join("-" if loss is None else f"{loss:.4f}" for loss in row["validation"])
    print(f"{network:18s} {name:16s} {losses}   validation {validation}   {row['epoch_s']} s an epoch", flush=True)


def run() -> None:
    """Compares the trainings of every network."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--networks", nargs="+", default=["unet", "spherical"])
    parser.add_argument("--size", default="desk")
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument("--places", nargs="+", choices=PLACES, default=PLACES, help="continued: on the CPU")
    parser.add_argument("--quick", action="store_true", help="places cpu and gpu alone")
    asked = parser.parse_args()
    asked.data, asked.output = asked.data.resolve(), asked.output.resolve()
    print(json.dumps({network: compared(network, asked) for network in asked.networks}))


if __name__ == "__main__":
    if _AS_RANK in sys.argv:
        os.environ["LOCAL_RANK"] = "0"  # both on the first GPU
        distributed.init_process_group("gloo")
        sys.exit(main(sys.argv[2:]))
    run()
