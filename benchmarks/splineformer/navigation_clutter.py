"""Navigation by SplineFormer among clutter: its perception network, and the navigator of random arches.

    python benchmarks/splineformer/navigation_clutter.py SPLINEFORMER --folder FOLDER [--train 0 1] [--subtracted]

SPLINEFORMER is the model file of the stage splineformer. The jobs are those of the stage navigation, without its other
stages: the perception network is fine-tuned once for each amount of clutter (`stage.clutter`) in training, with wires
that the shipped roadmap policy steers, and reads wires in further arches without and with clutter. With --rounds each
also gets a navigator of random arches, taught by the same policy, which is tried in unseen arches without and with
clutter. What is finished in the folder is not repeated.

Prints a JSON line for each amount in training: errors of tip and curve in px of 1,024, mean and median, and the share
of curves within 10 px, without and with clutter; success by target of the trials; processor time of each part.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

import enn
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.seeds import perception_arches, training_arches, unseen_arches
from pipeline.stages.navigation.frames import frames_in
from pipeline.stages.navigation.jobs import Course, NavigatorJob, navigate
from pipeline.stages.navigation.perception import PERCEPTION, PerceptionJob, fine_tune_perception, load_perception
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.navigation.stage import CLUTTERED, UNSEEN
from pipeline.stages.navigation.tables import ARCHES
from pipeline.stages.navigation.trials import TrialSet
from pipeline.stages.unseen.task import TEST_PHANTOM, training_arch
from pipeline.task import task_in_random_arches
from splineformer.comparison.curve_errors import curve_errors
from splineformer.navigation.perception import PerceptionNetwork

NEAR_PX = 10.0
DESK: dict[str, Any] = {
    "cameras": ["a", "b"], "image_size_px": 512, "phantoms": ["type_1"], "episodes": [20],
    "perception_arches": 30, "perception_frames": 72,
    "perception_epochs": 4, "arch_epochs": 20, "test_arches": 20,
}  # fmt: skip
TEST_FRAMES = 24  # in each further arch


def teacher() -> Path:
    """The shipped roadmap policy."""
    return Path(enn.__file__).parent / "weights" / "generalist.pt"


def settings(clutter: float, given: argparse.Namespace) -> NavigationSettings:
    """Settings of the stage at desk, with the wire that the teacher knows."""
    task = dataclasses.replace(task_in_random_arches(), wire_length_mm=380.0)
    few = {
        "perception_arches": 2,
        "perception_frames": 4,
        "perception_epochs": 1,
        "arch_epochs": 1,
        "arch_hidden": 16,
        "test_arches": 1,
    }
    return NavigationSettings(
        **{**DESK, **(few if given.quick else {})},
        clutter=clutter,
        subtracted=given.subtracted,
        task=task,
        arch_task=task,
    )


def perception_errors(network: PerceptionNetwork, chosen: NavigationSettings, seeds: range) -> dict[str, float]:
    """Errors of a perception network in further arches, px of 1,024."""
    found: list[tuple[float, float]] = []
    for seed in seeds:
        size = network.predictor.network.settings.image_px
        for pictures, curves in frames_in(training_arch(seed), chosen, 1, teacher(), size, cluttered=1):
            for picture, curve in zip(pictures, curves, strict=True):
                (reading,) = network([picture])
                errors = curve_errors(1024.0 * reading.points.astype(float), 1024.0 * curve)
                found.append((errors["tip_px"], errors["mean_px"]))
    tips, means = np.array(found).T
    summary: dict[str, NDArray[Any] | float] = {"tip": tips, "curve": means}
    row = {f"{name}_mean": float(np.mean(values)) for name, values in summary.items()}
    row |= {f"{name}_median": float(np.median(values)) for name, values in summary.items()}
    return row | {"within_10_px_pct": 100 * float((means < NEAR_PX).mean()), "n": len(found)}


def trained(clutter: float, given: argparse.Namespace) -> dict[str, Any]:
    """Everything for one amount of clutter in training."""
    folder, chosen = given.folder / f"clutter_{clutter:g}", settings(clutter, given)
    seed = given.seed
    arches = tuple(training_arch(one) for one in perception_arches(seed, chosen.perception_arches))
    began = time.process_time()
    job = PerceptionJob(folder / PERCEPTION, chosen, given.splineformer, arches, seed, teacher())
    fine_tune_perception(job, Report())
    row: dict[str, Any] = {"trained_with": clutter, "perception_cpu_s": time.process_time() - began}
    network = load_perception(folder)
    further = perception_arches(seed, chosen.perception_arches + given.arches)[chosen.perception_arches :]
    seen = dataclasses.replace(chosen, perception_frames=4 if given.quick else TEST_FRAMES)
    for name, amount in (("without", 0.0), ("with", 1.0)):
        row[name] = perception_errors(network, dataclasses.replace(seen, clutter=amount), further)
    if given.rounds:
        row |= navigated(folder, chosen, given)
    return row


def navigated(folder: Path, chosen: NavigationSettings, given: argparse.Namespace) -> dict[str, Any]:
    """The navigator of random arches, trained and tried."""
    seed, task = given.seed, chosen.arch_task
    tests = tuple((TEST_PHANTOM, arch) for arch in unseen_arches(chosen.test_arches))
    course = Course(
        teacher(), tuple(training_arch(one) for one in training_arches(seed, given.training_arches)),
        tuple(chosen.targets), task, hints=True, clutter=chosen.clutter,
    )  # fmt: skip
    job = NavigatorJob(
        folder, chosen, Origin("navigation", ARCHES, seed, "desk"),
        (TrialSet(UNSEEN, tests, 1, task), TrialSet(CLUTTERED, tests, 1, task, 1.0)),
        chosen.arch_hidden, chosen.arch_epochs, courses=(course,), rounds=given.rounds, round_episodes=given.episodes,
    )  # fmt: skip
    began = time.process_time()
    outcome = navigate(job, Report())
    success = {f"{one['test']}/{one['target']}": one["success_pct"] for one in outcome["tests"]}
    return {"success_pct": success, "rounds": outcome["rounds"], "navigator_cpu_s": time.process_time() - began}


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "splineformer", type=Path, metavar="SPLINEFORMER", help="predictor.pt of the stage splineformer"
    )
    parser.add_argument("--folder", type=Path, required=True, help="of what is trained")
    parser.add_argument("--train", type=float, nargs="+", default=[0.0, 1.0], help="amounts of clutter in training")
    parser.add_argument("--subtracted", action="store_true", help="images are divided by one without a wire")
    parser.add_argument("--arches", type=int, default=10, help="further arches that perception networks are tried in")
    parser.add_argument("--rounds", type=int, default=0, help="of advised episodes of a navigator; 0: none")
    parser.add_argument("--episodes", type=int, default=90, help="a round")
    parser.add_argument("--training-arches", type=int, default=100, help="of the navigator")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    parser.add_argument("--quick", action="store_true", help="a few frames and one epoch: figures mean nothing")
    given = parser.parse_args(words)
    if not given.splineformer.is_file():
        print(f"navigation_clutter.py: there is no file {given.splineformer}: run stage=splineformer", file=sys.stderr)
        return 1
    for clutter in given.train:
        print(json.dumps(trained(clutter, given)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
