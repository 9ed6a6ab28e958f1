"""Tests of the stage `unseen`: anatomies, wires and registrations that a policy has not met, and its episodes there."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.recording.trials import Controller, Origin, run_trials, summary
from pipeline.seeds import held_out_seeds, unseen_arches
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.store.atomic_files import atomic_path
from pipeline.task import DESCENDING

if TYPE_CHECKING:
    from cathsim.fluoroscopy import XRayScene
    from cathsim.metrics import EpisodeMetrics
    from pipeline.stages.unseen.task import UnseenTask


@dataclass(frozen=True)
class HeldOutSet:
    """Anatomies and a wire that a policy has not been trained with."""

    name: str
    phantoms: tuple[str | int | AnatomyFile, ...]  # names, files, or seeds of random arches
    episodes: int = 1  # on each, for each target
    wire: str = "default"  # a preset, "softer" or "stiffer"
    modes: tuple[str, ...] = ("deterministic",)  # "deterministic", "stochastic"
    registration_noise: float = 0.0  # of the roadmap, m an axis
    targets: tuple[str, ...] = ()  # in these anatomies; none: those of the policy
    entry: str = DESCENDING  # in these anatomies
    clutter: float = 0.0  # in X-ray images


@dataclass(frozen=True, kw_only=True)
class PolicyJob:
    """A policy to train and to test."""

    folder: Path
    origin: Origin  # kept in the logs; its row and seed name the policy's folder, its seed is that of everything
    task: UnseenTask
    anatomies: tuple[int, ...]  # seeds of the random arches trained on
    tests: tuple[HeldOutSet, ...] = ()  # that the policy is put to

    @property
    def seed(self) -> int:
        return self.origin.training_seed

    @property
    def own_folder(self) -> Path:
        return policy_folder(self.folder, self.origin.row, self.seed)


def policy_folder(folder: Path, row: str, seed: int) -> Path:
    """Where the policy of a row and seed lies in the stage's folder."""
    return folder / row / f"seed{seed}"


def taken_over(start: Path, file: Path) -> Path:
    """The file of a policy that is not trained here, as the job's own."""
    if not file.is_file():
        with atomic_path(file) as unfinished:
            shutil.copyfile(start, unfinished)
    return file


def run_tests(
    job: PolicyJob,
    controllers: Callable[[str], Callable[[int], Controller]],
    observation: tuple[str, ...],
    report: Callable[[float, str], None],
    seen: Callable[[Any, float, XRayScene | None], Any] = lambda environment, clutter, background: environment,
) -> list[dict[str, Any]]:
    """Puts a policy to its tests; episodes whose log is there are not repeated.

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
                phantom.background() if isinstance(phantom, AnatomyFile) else None,
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


UNSEEN, MISREGISTERED, CLUTTERED = "unseen", "misregistered", "unseen clutter"  # sets of tests


def test_sets(settings: UnseenSettings) -> tuple[HeldOutSet, ...]:
    """A policy's tests: unseen random arches first, named phantoms or a file, other wires."""
    unseen = tuple(unseen_arches(settings.test_anatomies))
    wire = settings.task.wire
    tests = [HeldOutSet(UNSEEN, unseen, wire=wire, modes=("deterministic", "stochastic"))]
    own: dict[str, Any] = {"wire": wire, "targets": tuple(settings.own_targets), "entry": settings.own_entry}
    for name in settings.phantoms:
        count = settings.mesh_episodes if name == settings.file_name else settings.named_episodes
        tests.append(HeldOutSet(name, (settings.anatomy(name),), count, **own))
    tests += [HeldOutSet(f"{UNSEEN} {kind}", unseen[: settings.wire_anatomies], wire=kind) for kind in settings.wires]
    return tuple(tests)


def cluttered(settings: UnseenSettings) -> tuple[HeldOutSet, ...]:
    """The test of the X-ray policy among clutter, on the first of the unseen arches."""
    arches = tuple(unseen_arches(settings.test_anatomies))[: settings.clutter_anatomies]
    return (
        (HeldOutSet(CLUTTERED, arches, wire=settings.task.wire, clutter=settings.clutter),) if settings.clutter else ()
    )


def misregistered(settings: UnseenSettings) -> tuple[HeldOutSet, ...]:
    """The tests of the roadmap policy with errors of the registration, on the same arches and starts as without."""
    arches = tuple(unseen_arches(settings.test_anatomies))
    return tuple(
        HeldOutSet(f"{MISREGISTERED} {noise:g} mm", arches, wire=settings.task.wire, registration_noise=noise / 1e3)
        for noise in settings.registration_noise_mm
        if noise
    )
