"""Benchmark of generalisation: what the roadmap, the egocentric view and many anatomies cost, and how policies did.

    python benchmarks/enn/unseen.py [--quick] [--run runs/desk]

Prints tables, and one JSON object as its last line. Times are CPU milliseconds of one core, since other work may run
beside. Success comes from a finished stage `unseen` of the run, and is left out where there is none.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

from cathsim import load_guidewire
from cathsim.anatomy.generator.random_arch import sample_parameters
from cathsim.anatomy.library import build_phantom
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.wire_placement import laid_starts
from enn.imitation.images.egocentric import VIEW_SIZE
from enn.imitation.images.lumen_segmentation import LumenSegmenter
from enn.imitation.images.perception import ImagePerception
from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from pipeline.report.learning.tables import tables_from_logs

FORWARD = np.array([1.0, 0.3])
RESOLUTION = 1e-3  # m, that of the training anatomies


def cpu_ms(work: Callable[[], Any], repeats: int) -> float:
    """Mean CPU time of a call, ms."""
    work()
    began = time.process_time()
    for _ in range(repeats):
        work()
    return 1e3 * (time.process_time() - began) / repeats


def costs(repeats: int) -> dict[str, float]:
    """What each part costs, ms."""
    wire = load_guidewire("default").scaled(0.312)
    keys = ("image", "mask", "goal_image", "roadmap", "history")
    env = NavigateManyEnv((0, 1), wires=(wire,), resolution=RESOLUTION, observation=keys, image_size=192)
    perception = ImagePerception(LumenSegmenter())
    policy = RecurrentPolicy(RecurrentPolicySettings(features=VIEW_SIZE))
    observation, _ = env.reset(seed=0, options={"case": 0})
    first = observation
    for _ in range(60):
        observation = env.step(FORWARD)[0]
    view = perception.begin(first).cameras[0]
    seen = view.look(observation["image"], observation["mask"], FORWARD)
    cases = iter(range(10**9))

    def build() -> None:
        phantom = build_phantom("own", sample_parameters(np.random.default_rng(next(cases))), resolution=RESOLUTION)
        for target in ("bca", "lcca"):
            phantom.geodesic_field(target)

    def remember() -> None:
        history = env.current.history
        assert history is not None
        history.advance(*FORWARD)
        history.read()

    laid = NavigateManyEnv((0,), ("lcca",), (wire,), resolution=RESOLUTION, observation="tip").current
    generator = np.random.default_rng(0)
    return {
        "build an anatomy with two geodesic fields": cpu_ms(build, max(repeats // 100, 2)),
        "plan a way and lay the wire, 24 starts": cpu_ms(lambda: laid_starts(laid, generator), max(repeats // 200, 1)),
        "reset into another anatomy": cpu_ms(lambda: env.reset(options={"case": 2 * (next(cases) % 2)}), repeats),
        "roadmap": cpu_ms(env.current.roadmap.read, 5 * repeats),
        "history, a step": cpu_ms(remember, 5 * repeats),
        "first image: segmentation and map": cpu_ms(lambda: perception.begin(first), max(repeats // 10, 3)),
        "egocentric view": cpu_ms(lambda: view.look(observation["image"], observation["mask"], FORWARD), repeats),
        "recurrent policy": cpu_ms(lambda: policy.act(seen[None]), repeats),
    }


def success(run: Path) -> dict[str, dict[str, Any]]:
    """The tables of a finished stage `unseen`; empty where there is none."""
    file = run / "unseen" / "results.json"
    if not file.is_file():
        return {}
    tables = {**tables_from_logs(run / "unseen"), **json.loads(file.read_text(encoding="utf-8"))}
    return {name: tables[name] for name in ("generalisation", "generalisation_curve", "registration") if name in tables}


def main() -> None:
    """Prints the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
    parser.add_argument("--run", type=Path, default=Path("runs/desk"), help="a run with a finished stage unseen")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    measured = costs(50 if arguments.quick else 400)
    print(f"{'CPU time':46} {'ms':>9}")
    for name, value in measured.items():
        print(f"{name:46} {value:9.3f}")
    tables = success(arguments.run)
    for title, rows in tables.items():
        print(f"\n{title}")
        for row, columns in rows.items():
            print(f"{row:46} " + "  ".join(f"{name} {value}" for name, value in columns.items()))
    print(json.dumps({"cpu_ms": {name: round(value, 4) for name, value in measured.items()}, **tables}))


if __name__ == "__main__":
    main()
