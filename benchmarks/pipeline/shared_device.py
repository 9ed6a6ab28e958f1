"""How many trainings can share a GPU, or a machine's cores, before they slow each other down.

    python benchmarks/pipeline/shared_device.py [--row "enn I+V+M"] [--processes 1 2 4 8] [--seconds S] [--device cuda]

So many processes with one thread each make updates of a training of `budget=thesis` (a row of
`benchmarks/pipeline/thesis_updates.py`) at the same time, for S seconds after all of them are ready. Prints a table
and, in its last line, a JSON object: by the number of processes update_ms (mean time of an update in one of them) and
updates_a_second (of all together), and of a GPU used_gb, its memory while they run.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing as mp
import time
from multiprocessing.synchronize import Barrier
from typing import Any

from benchmarks.pipeline.thesis_updates import ROWS, update_of

PATIENCE = 300.0  # s until all processes are ready


def updates_made(row: str, device: str, seconds: float, ready: Barrier, made: Any) -> None:
    """Makes updates for a time that begins when all processes are ready; puts their number and the time taken."""
    import torch

    torch.set_num_threads(1)
    update, _ = update_of(row, device)

    def finish() -> None:
        if device != "cpu":
            torch.cuda.synchronize()

    for _ in range(3):
        update()
    finish()
    ready.wait(PATIENCE)
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < seconds:
        update()
        finish()
        count += 1
    used = 0.0
    if device != "cpu":
        free, total = torch.cuda.mem_get_info()
        used = (total - free) / 1e9
    made.put((count, time.perf_counter() - begun, used))
    ready.wait(PATIENCE)  # memory is read while all of them are there


def shared(row: str, processes: int, device: str, seconds: float) -> dict[str, float]:
    """Times of updates while so many processes make them."""
    context = mp.get_context("spawn")
    ready, made = context.Barrier(processes), context.Queue()
    workers = [
        context.Process(target=updates_made, args=(row, device, seconds, ready, made), daemon=True)
        for _ in range(processes)
    ]
    for worker in workers:
        worker.start()
    outcomes = [made.get(timeout=PATIENCE + 10 * seconds) for _ in workers]
    for worker in workers:
        worker.join()
    rates = [count / taken for count, taken, _ in outcomes]
    result = {
        "update_ms": round(1e3 * processes / sum(rates), 2),
        "updates_a_second": round(sum(rates), 2),
    }
    return result | ({"used_gb": round(max(used for *_, used in outcomes), 2)} if device != "cpu" else {})


def main() -> None:
    """Measures each number of processes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--row", choices=tuple(ROWS), default="enn I+V+M", metavar="ROW", help="of thesis_updates.py")
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    asked = parser.parse_args()
    results: dict[int, dict[str, float]] = {}
    print(f"{asked.row}\n{'processes':>9s} {'update, ms':>10s} {'updates a second':>16s}")
    for processes in asked.processes:
        found = results[processes] = shared(asked.row, processes, asked.device, asked.seconds)
        print(f"{processes:9d} {found['update_ms']:10.2f} {found['updates_a_second']:16.2f}", flush=True)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
