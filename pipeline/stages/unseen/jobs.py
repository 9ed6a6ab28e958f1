"""Jobs of the stage `unseen`: anatomies and roadmap policies, and their logged episodes.

A policy's folder, ``<row>/seed<k>/``, draws as::

    policy.pt  training.csv  training.json
    checkpoint/                                   until it is finished
    evaluation/<test set>/<target>/<mode>/<phantom>/NNN.mcap
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.jobs.worker import Report
from pipeline.recording.trials import Controller, Origin
from pipeline.stages.unseen.demonstrations import read_demonstrations
from pipeline.stages.unseen.starts import read_starts
from pipeline.stages.unseen.task import RESOLUTION, ROADMAP_KEYS, UnseenTask
from pipeline.stages.unseen.trials import HeldOutSet, run_tests
from pipeline.store.errors import stopping_the_stage
from pipeline.task import TASK

if TYPE_CHECKING:
    from enn.reinforcement.training import TrainingSettings

POLICY = "policy.pt"
PRELOAD = (
    "cathsim.many_anatomies",
    "enn.reinforcement.training",
    "enn.imitation.advised_episodes",
    "pipeline.recording.record",
)


@dataclass(frozen=True)
class AnatomiesJob:
    """Random arches to build into the cache.

    Attributes:
        arches: kind and seed of each.
        targets: whose ways are laid out in them.
    """

    arches: tuple[tuple[str, int], ...]
    targets: tuple[str, ...]


@dataclass(frozen=True)
class RoadmapJob:
    """A policy on the local roadmap to train and to test.

    Attributes:
        folder: of the policy.
        task: of its episodes.
        anatomies: seeds of the random arches trained on.
        settings: of the training.
        seed: of the training.
        origin: kept in the logs.
        tests: that it is put to.
        demonstrations: folder of demonstrations; those in its anatomies are learnt from.
        starts: folder of laid starts; those in its anatomies go into the reset bank.
        validated: seeds of random arches that the best policy is chosen by; none: those trained on.
    """

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]
    settings: TrainingSettings
    seed: int
    origin: Origin
    tests: tuple[HeldOutSet, ...]
    demonstrations: Path | None = None
    starts: Path | None = None
    validated: tuple[int, ...] = ()


def build_anatomies(job: AnatomiesJob, report: Report) -> dict[str, Any]:
    """Builds random arches into the cache of phantoms."""
    from cathsim.anatomy import load_phantom

    for done, (kind, seed) in enumerate(job.arches):
        report(done / len(job.arches), f"arch {seed}")
        phantom = load_phantom(kind, seed=seed, resolution=RESOLUTION)
        for target in job.targets:
            phantom.geodesic_field(target)
    return {"anatomies": len(job.arches)}


def train_roadmap(job: RoadmapJob, report: Report) -> dict[str, Any]:
    """Trains a policy on the roadmap and tests it; each part only where it lacks.

    Returns:
        ``training_s`` and a summary for each test set, target and mode.
    """
    from cathsim.many_anatomies import SHELF
    from enn.reinforcement.checkpoint import CheckpointError
    from enn.reinforcement.training import Training

    for leftover in job.folder.glob(".*.tmp"):
        leftover.unlink()
    validated = partial(job.task.training_environment, job.validated, ROADMAP_KEYS, "accurate")
    SHELF.capacity = max(SHELF.capacity, len(job.anatomies) + len(job.validated))  # all take turns
    training = Training(
        replace(job.settings, device=report.device),
        partial(job.task.training_environment, job.anatomies, ROADMAP_KEYS),
        job.folder,
        seed=job.seed,
        demonstrations=[] if job.demonstrations is None else read_demonstrations(job.demonstrations, job.anatomies),
        metadata={**job.origin.configuration("training"), TASK: asdict(job.task.task)},
        starts=[] if job.starts is None else read_starts(job.starts, job.anatomies, job.task.targets),
        make_validation_env=validated if job.validated else None,
    )
    with stopping_the_stage(CheckpointError):
        result = training.run(lambda p: report(0.7 * p.decisions / p.total, f"success {100 * (p.success or 0):.0f} %"))

    def controllers(mode: str) -> Callable[[int], Controller]:
        return lambda seed: result.policy.controller(deterministic=mode == "deterministic", seed=seed)

    tested = run_tests(job, controllers, ROADMAP_KEYS, report.part(0.7, 1.0, "tests"))
    return {"training_s": result.timings["wall_s"], "tests": tested}
