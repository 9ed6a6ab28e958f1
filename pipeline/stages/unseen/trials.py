"""Tests of the stage `unseen`: anatomies, wires and registrations that a policy has not met, and its episodes there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.recording.trials import Controller, Origin, run_trials, summary
from pipeline.seeds import held_out_seeds
from pipeline.task import DESCENDING

if TYPE_CHECKING:
    from cathsim.fluoroscopy import XRayScene
    from cathsim.metrics import EpisodeMetrics
    from pipeline.stages.unseen.task import UnseenTask


@dataclass(frozen=True)
class HeldOutSet:
    """Anatomies and a wire that a policy has not been trained with.

    Attributes:
        phantoms: names, files, or seeds of random arches.
        episodes: on each, for each target.
        wire: a preset, "softer" or "stiffer".
        modes: "deterministic", "stochastic".
        registration_noise: of the roadmap, m an axis.
        targets: in these anatomies; none: those of the policy.
        entry: in these anatomies.
        clutter: in X-ray images.
    """

    name: str
    phantoms: tuple[str | int | AnatomyFile, ...]
    episodes: int = 1
    wire: str = "default"
    modes: tuple[str, ...] = ("deterministic",)
    registration_noise: float = 0.0
    targets: tuple[str, ...] = ()
    entry: str = DESCENDING
    clutter: float = 0.0


@dataclass(frozen=True, kw_only=True)
class PolicyJob:
    """A policy to train and to test.

    Attributes:
        origin: kept in the logs; its row and seed name the policy's folder, its seed is that of everything.
        anatomies: seeds of the random arches trained on.
        tests: that the policy is put to.
    """

    folder: Path
    origin: Origin
    task: UnseenTask
    anatomies: tuple[int, ...]
    tests: tuple[HeldOutSet, ...] = ()

    @property
    def seed(self) -> int:
        """Of the training."""
        return self.origin.training_seed

    @property
    def own_folder(self) -> Path:
        """Of the policy."""
        return policy_folder(self.folder, self.origin.row, self.seed)


def policy_folder(folder: Path, row: str, seed: int) -> Path:
    """Where the policy of a row and seed lies in the stage's folder."""
    return folder / row / f"seed{seed}"


def run_tests(
    job: PolicyJob,
    controllers: Callable[[str], Callable[[int], Controller]],
    observation: tuple[str, ...],
    report: Callable[[float, str], None],
    seen: Callable[[Any, float, XRayScene | None], Any] = lambda environment, clutter, room: environment,
) -> list[dict[str, Any]]:
    """Puts a policy to its tests; episodes whose log is there are not repeated.

    Args:
        job: whose tests.
        controllers: gives, for a mode, the policy for the episode of a seed.
        report: takes the share done and a few words.
        seen: the environment as the policy sees it, with so much clutter, in a room of its own or the usual one.

    Returns:
        A row for each test set, target and mode: their names and the summary of the episodes.
    """
    rows = []
    cells = [
        (test, target, mode) for test in job.tests for target in test.targets or job.task.targets for mode in test.modes
    ]
    total = sum(len(test.phantoms) for test, _, _ in cells)
    done = 0
    for test, target, mode in cells:
        metrics: list[EpisodeMetrics] = []
        further = {**job.origin.further, "test_set": test.name, "training_anatomies": len(job.anatomies)}
        for place, phantom in enumerate(test.phantoms):
            environment = seen(
                job.task.test_environment(phantom, target, test.wire, observation, test.registration_noise, test.entry),
                test.clutter,
                phantom.room() if isinstance(phantom, AnatomyFile) else None,
            )
            seeds = held_out_seeds(job.seed, len(test.phantoms) * test.episodes)
            metrics += run_trials(
                environment,
                controllers(mode),
                job.own_folder / "evaluation" / test.name / target / mode / environment.phantom.name,
                seeds=seeds[place * test.episodes : (place + 1) * test.episodes],
                mode=mode,
                origin=replace(job.origin, further=further),
            )
            environment.close()
            done += 1
            won = sum(one.success for one in metrics)
            report(done / total, f"{test.name} {target} {won}/{len(metrics)}")
        rows.append({"test_set": test.name, "target": target, "mode": mode, **summary(metrics)})
    return rows
