"""Trials of a navigator on held-out starts: logged, resumable one by one, failures counted by their mode."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.metrics.failure_modes import MODES as FAILURES
from cathsim.metrics.failure_modes import failure_mode
from pipeline.episodes import EpisodeReader
from pipeline.recording.trials import MODES, Controller, Origin, run_trials
from pipeline.seeds import held_out_seeds
from pipeline.stages.navigation.scene import Anatomy, Scene, in_view, scene_of
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.store.errors import StageError
from pipeline.task import Task

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from cathsim.metrics import EpisodeMetrics
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from splineformer.navigation.navigator_perception import NavigatorPerception


EVALUATION = "evaluation"


@dataclass(frozen=True)
class TrialSet:
    """Trials on held-out starts."""

    name: str
    anatomies: tuple[Anatomy, ...]  # one after the other
    trials: int  # in each, for each target
    task: Task
    clutter: float = 0.0  # in the images


def run_tests(
    policy: RecurrentPolicy,
    perception: NavigatorPerception,
    tests: Sequence[TrialSet],
    settings: NavigationSettings,
    folder: Path,
    origin: Origin,
    *,
    report: Callable[[float, str], None],
) -> list[dict[str, Any]]:
    """Puts a navigator to its trials; those whose log is there are not repeated.

    Returns:
        A row for each set and target: success, mean time of successful trials, forces, failure modes, number, and in
        how many anatomies the target lies outside the cameras' images, where there is no trial.
    """
    rows = []
    cells = [(test, target) for test in tests for target in settings.targets]
    total, done = sum(len(test.anatomies) for test, _ in cells), 0
    for test, target in cells:
        metrics: list[EpisodeMetrics] = []
        failures = Counter(dict.fromkeys(FAILURES, 0))
        seeds = held_out_seeds(origin.training_seed, len(test.anatomies) * test.trials)
        out_of_view = 0
        for place, anatomy in enumerate(test.anatomies):
            done += 1
            if not in_view(anatomy, target, settings.arms):
                out_of_view += 1
                continue
            scene = scene_of(test.task, anatomy, target, settings.arms, ("tip",), clutter=test.clutter)
            environment = scene.environment
            logs_in = folder / EVALUATION / test.name / target / environment.phantom.name
            metrics += run_trials(
                environment,
                controllers(policy, perception, scene),
                logs_in,
                seeds=seeds[place * test.trials : (place + 1) * test.trials],
                mode=MODES[0],
                origin=origin,
            )
            logs = [logs_in / f"{index:03d}.mcap" for index in range(test.trials)]
            failures.update(count_failures(logs, environment.phantom))
            environment.close()
            report(done / total, f"{test.name} {target} {sum(one.success for one in metrics)}/{len(metrics)}")
        if not metrics:
            raise StageError(f"the cameras see the {target} in none of {test.name}; choose other stage.cameras.")
        row = {"test": test.name, "target": target, **summary(metrics), **failures, "out_of_view": out_of_view}
        rows.append(row)
    return rows


def controllers(policy: RecurrentPolicy, perception: NavigatorPerception, scene: Scene) -> Callable[[int], Controller]:
    """What steers the episode of a seed; the navigator asks for images, never for the observation."""
    from enn.imitation.recurrent_policy import RecurrentController

    return lambda seed: RecurrentController(policy, perception, lambda first: scene.view(perception.settings))


def count_failures(logs: Iterable[Path], phantom: Phantom) -> dict[str, int]:
    """How often each of `cathsim.metrics.failure_modes.MODES` occurs among trials in one anatomy."""
    counts = dict.fromkeys(FAILURES, 0)
    for log in logs:
        with EpisodeReader(log) as episode:
            if episode.outcome.success:
                continue
            info, tips = episode.info, episode.load_arrays(pictures=False)["tip"]
        steps_allowed = int(info.configuration["max_steps"])
        counts[failure_mode(phantom, info.target, tips, steps_allowed=steps_allowed, entry=info.entry)] += 1
    return counts


def summary(metrics: Sequence[EpisodeMetrics]) -> dict[str, Any]:
    """Success in %, median depth in mm, mean time of the successful trials in s (None without), forces in N, number."""
    from cathsim.metrics import median_depth_mm
    from cathsim.simulation import CONTROL_STEP

    times = [CONTROL_STEP * one.steps for one in metrics if one.success]
    return {
        "success_pct": 100.0 * float(np.mean([one.success for one in metrics])),
        "depth_mm": median_depth_mm(metrics),
        "time_s": float(np.mean(times)) if times else None,
        "force_n": float(np.mean([one.force_mean for one in metrics])),
        "force_max_n": float(np.max([one.force_max for one in metrics])),
        "n": len(metrics),
    }
