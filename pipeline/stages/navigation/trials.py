"""Trials of a navigator on held-out starts: logged, resumable one by one, failures told apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.recording.trials import MODES, Controller, Origin, run_trials
from pipeline.seeds import held_out_seeds
from pipeline.stages.navigation.failures import count_failures
from pipeline.stages.navigation.scene import Rig, Scene
from pipeline.stages.navigation.task import TrialSet

if TYPE_CHECKING:
    from cathsim.metrics import EpisodeMetrics
    from splineformer.navigation.navigator import Navigator

EVALUATION = "evaluation"


def run_tests(
    navigator: Navigator,
    tests: Sequence[TrialSet],
    targets: Sequence[str],
    rig: Rig,
    folder: Path,
    *,
    seed: int,
    origin: Origin,
    report: Callable[[float, str], None],
) -> list[dict[str, Any]]:
    """Puts a navigator to its trials; those whose log is there are not repeated.

    Args:
        navigator: that steers.
        tests: sets of trials.
        targets: of each.
        rig: of the images.
        folder: of the navigator.
        seed: of its training.
        origin: kept in the logs.
        report: takes the share done and a few words.

    Returns:
        A row for each set and target: success, mean time of successful trials, forces, failure modes, number.
    """
    rows = []
    cells = [(test, target) for test in tests for target in targets]
    total, done = sum(len(test.anatomies) for test, _ in cells), 0
    for test, target in cells:
        metrics: list[EpisodeMetrics] = []
        failures: dict[str, int] = {}
        seeds = held_out_seeds(seed, len(test.anatomies) * test.trials)
        for place, anatomy in enumerate(test.anatomies):
            scene = test.rules.scene(anatomy, target, rig, ("tip",))
            environment = scene.environment
            logs_in = folder / EVALUATION / test.name / target / environment.phantom.name
            metrics += run_trials(
                environment,
                controllers(navigator, scene),
                logs_in,
                seeds=seeds[place * test.trials : (place + 1) * test.trials],
                mode=MODES[0],
                origin=origin,
            )
            logs = [logs_in / f"{index:03d}.mcap" for index in range(test.trials)]
            for mode, count in count_failures(logs, environment.phantom).items():
                failures[mode] = failures.get(mode, 0) + count
            environment.close()
            done += 1
            report(done / total, f"{test.name} {target} {sum(one.success for one in metrics)}/{len(metrics)}")
        rows.append({"test": test.name, "target": target, **summary(metrics), **failures})
    return rows


def controllers(navigator: Navigator, scene: Scene) -> Callable[[int], Controller]:
    """What steers the episode of a seed; the navigator asks for images, never for the observation."""
    space = scene.space if navigator.settings.space else None
    return lambda seed: navigator.controller(scene.images, scene.marks, scene.vessels, space)


def summary(metrics: Sequence[EpisodeMetrics]) -> dict[str, Any]:
    """Success in %, mean simulated time of the successful trials in s (None without), forces in N, number."""
    from cathsim.simulation import CONTROL_STEP

    times = [CONTROL_STEP * one.steps for one in metrics if one.success]
    return {
        "success_pct": 100.0 * float(np.mean([one.success for one in metrics])),
        "time_s": float(np.mean(times)) if times else None,
        "force_n": float(np.mean([one.force_mean for one in metrics])),
        "force_max_n": float(np.max([one.force_max for one in metrics])),
        "n": len(metrics),
    }
