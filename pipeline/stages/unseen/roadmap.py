"""Roadmap policies of the stage `unseen`, the anatomies that they learn in, demonstrations there, and starts.

A policy's folder, ``<row>/seed<k>/``, holds::

    policy.pt  training.csv  training.json
    checkpoint/                                   until it is finished
    evaluation/<test set>/<target>/<mode>/<phantom>/NNN.mcap

A demonstration of the sampling expert is a file, ``demonstrations/<target>_<anatomy>.npz`` in the stage's folder, with
all that an `enn.trajectory.Trajectory` holds; of one that fails it says only that, so that it is not tried again.
``starts/<anatomy>.npz`` has an array of states for each target: the wire inserted along the planned way to some places
before the target, and each of them withdrawn a little, turning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from enn.curves import chosen_logger
from pipeline.jobs.worker import Report, map_simulations
from pipeline.recording.training_films import training_films
from pipeline.recording.trials import POLICY, controllers
from pipeline.seeds import arch_demonstration_seed
from pipeline.stages.learning.settings import with_hyperparameters
from pipeline.stages.learning.training import words
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import ROADMAP_KEYS
from pipeline.stages.unseen.trials import PolicyJob, run_tests, taken_over
from pipeline.store.atomic_files import write_arrays
from pipeline.store.errors import ConfigurationError, stopping_the_stage
from pipeline.task import MOTION, TASK, decision_steps, differences, task_from

if TYPE_CHECKING:
    from enn.policy import Policy
    from enn.reinforcement.training.settings import TrainingSettings
    from enn.trajectory import Trajectory
    from pipeline.stages.unseen.task import UnseenTask

ARRIVED = "terminated"  # name in the file: whether the target was reached


def demonstration_arrays(episode: Trajectory) -> dict[str, Any]:
    """The arrays of an episode by their names in the file; of one that did not arrive, only that."""
    if not episode.terminated:
        return {ARRIVED: np.array(False)}
    return {
        **episode.observations,
        "actions": episode.actions,
        "rewards": episode.rewards,
        ARRIVED: np.array(True),
        "forces": episode.forces,
        "tips": episode.tips,
        "states": episode.simulation_states,
    }


def arrived(path: Path) -> bool:
    with np.load(path) as arrays:
        return bool(arrays[ARRIVED])


def read_demonstration(path: Path, **metadata: Any) -> Trajectory | None:
    """The episode of a file, with further metadata; None: it did not reach its target."""
    from enn.trajectory import Trajectory

    with np.load(path) as arrays:
        if not arrays[ARRIVED]:
            return None
        return Trajectory(
            {key: arrays[key] for key in ROADMAP_KEYS},
            arrays["actions"],
            arrays["rewards"],
            True,
            arrays["forces"],
            arrays["tips"],
            arrays["states"],
            {"file": str(path), **metadata},
        )


DEMONSTRATIONS = "demonstrations"  # job and folder


@dataclass(frozen=True)
class DemonstrationsJob:
    """Demonstrations to make."""

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]  # seeds of all random arches trained on, so that states know their case
    demonstrated: tuple[int, ...]  # those of them with a demonstration each
    target: str
    hold: int  # steps for which the expert holds an action: those of a decision of the policy
    seed: int


def record_demonstrations(job: DemonstrationsJob, report: Report) -> dict[str, Any]:
    """Plays the episodes whose file is not there yet: how many there are, and how many reached their target."""
    from cathsim.planning.demonstration import demonstrate

    environment = job.task.training_environment(job.anatomies, ROADMAP_KEYS)
    target = job.task.targets.index(job.target)
    reached = 0
    for done, seed in enumerate(job.demonstrated):
        text = f"{job.target} of arch {seed}, {reached}/{done} reached"
        path = job.folder / f"{job.target}_{seed}.npz"
        if not path.is_file():
            case = environment.case_of(job.anatomies.index(seed), target)
            tick = partial(report, done / len(job.demonstrated), text)
            seed_of_start = arch_demonstration_seed(job.seed)
            write_arrays(
                path, demonstrate(environment, case, ROADMAP_KEYS, hold=job.hold, seed=seed_of_start, tick=tick)
            )
        reached += arrived(path)
    environment.close()
    return {"shown": len(job.demonstrated), "reached": reached}


def read_demonstrations(folder: Path, anatomies: Sequence[int]) -> list[Trajectory]:
    """The demonstrations that reached their target, in random arches of these seeds; none where none were made."""
    demonstrations = []
    for path in sorted(folder.glob("*.npz")):
        target, anatomy = path.stem.split("_")
        if int(anatomy) in anatomies:
            demonstration = read_demonstration(path, target=target, anatomy=int(anatomy))
            demonstrations += [] if demonstration is None else [demonstration]
    return demonstrations


STARTS = "starts"  # job and folder


@dataclass(frozen=True)
class StartsJob:
    """Start states at which the wire is inserted."""

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]  # seeds of the random arches
    seed: int  # of the turns while drawing back


def insert_starts(job: StartsJob, report: Report) -> dict[str, Any]:
    """Inserts the wire at start states in anatomies whose file is not there yet: how many anatomies and states."""
    from cathsim.devices.wire_placement import inserted_starts

    states = 0
    environment = None
    for place, anatomy in enumerate(job.anatomies):
        report(place / len(job.anatomies), f"starts in arch {anatomy}")
        path = job.folder / f"{anatomy}.npz"
        if not path.is_file():
            environment = environment or job.task.training_environment(job.anatomies, ("tip",))
            generator = np.random.default_rng((job.seed, anatomy))
            arrays = {}
            for number, target in enumerate(job.task.targets):
                environment.reset(seed=0, options={"case": environment.case_of(place, number)})
                arrays[target] = inserted_starts(environment.current, generator)
            write_arrays(path, arrays)
        with np.load(path) as content:
            states += sum(len(content[target]) for target in job.task.targets)
    if environment is not None:
        environment.close()
    return {"anatomies": len(job.anatomies), "states": states}


def read_starts(folder: Path, anatomies: Sequence[int], targets: Sequence[str]) -> list[np.ndarray]:
    """Starts for an environment over random arches of these seeds: a case each, its number last. Shapes (k, n + 1)."""
    starts = []
    for place, anatomy in enumerate(anatomies):
        with np.load(folder / f"{anatomy}.npz") as arrays:
            for number, target in enumerate(targets):
                if len(states := arrays[target]):
                    case = np.full((len(states), 1), place * len(targets) + number, float)
                    starts.append(np.concatenate((states, case), axis=1))
    return starts


EVALUATIONS = 5  # of a training
_ACTS_FIRST = 0.05  # of the decisions, where a training starts from a policy: it fills the replay buffer


def training_settings(
    settings: UnseenSettings,
    anatomies: int,
    decisions: int,
    evaluations: int = EVALUATIONS,
    start: Policy | None = None,
) -> TrainingSettings:
    """Those of the roadmap policies on so many anatomies; the best of `evaluations` on the validation's decides."""
    from enn.reinforcement.rehearsal import MANY_CASES, starting_from

    training = replace(
        MANY_CASES,
        hidden=(settings.hidden, settings.hidden),
        decisions=decisions,
        buffer_size=max(decisions, 1000),
        learning_starts=min(MANY_CASES.learning_starts, decisions // 4),
        action_repeat=decision_steps(settings.task),
        start_state_buffer_cases=anatomies * len(settings.learnt_targets()),
        evaluate_every=max(decisions // evaluations, 1),
        evaluation_episodes=settings.validation_episodes,
        logger=chosen_logger(),
    )
    if start is not None:
        training = starting_from(training, start, _ACTS_FIRST)
    return with_hyperparameters(training, settings.training)


def policy_to_start_from(settings: UnseenSettings) -> Policy | None:
    """The policy of `stage.policy`, if there is one."""
    if settings.policy is None:
        return None
    from enn.policy import Policy

    try:
        policy = Policy.load(Path(str(settings.policy)))
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"stage.policy={settings.policy} can't be read: {error}") from None
    if policy.keys != ROADMAP_KEYS or (settings.decisions and not policy.critics):
        with_critics = " that was saved with critics" if settings.decisions else ""
        raise ConfigurationError(
            f"stage.policy={settings.policy} is no policy by a roadmap{with_critics}: give such a one"
        )
    task = task_from(policy.metadata.get(TASK))
    if not settings.decisions and task is not None and (differing := differences(settings.task, task, MOTION)):
        values = ", ".join(f"stage.task.{name}={getattr(task, name)}" for name in differing)
        raise ConfigurationError(f"stage.policy={settings.policy} was trained with {values}: give the stage the same")
    return policy


@dataclass(frozen=True, kw_only=True)
class RoadmapJob(PolicyJob):
    """A policy on the local roadmap."""

    settings: TrainingSettings | None  # of its training; None: the policy of `start` is taken as it is
    validated: tuple[int, ...]  # seeds of random arches that the best policy is chosen by
    start: Path | None = None  # file of the policy that it starts from; None: from nothing


def train_roadmap(job: RoadmapJob, report: Report) -> dict[str, Any]:
    """Trains a policy on the roadmap and tests it, each where it lacks: ``training_s`` and summaries."""
    from enn.policy import Policy

    map_simulations()
    if job.settings is None:
        assert job.start is not None, "without a training there is a policy to take"
        policy, training_s = Policy.load(taken_over(job.start, job.own_folder / POLICY)), 0.0
    else:
        policy, training_s = _trained(job, job.settings, report)
    tested = run_tests(job, partial(controllers, policy), ROADMAP_KEYS, report.part(0.7, 1.0, "tests"))
    return {"training_s": training_s, "tests": tested}


def _trained(job: RoadmapJob, settings: TrainingSettings, report: Report) -> tuple[Policy, float]:
    """The policy of a training, and the seconds that it took."""
    from cathsim.many_anatomies import SHELF
    from enn.policy import Policy
    from enn.reinforcement.checkpoint import CheckpointError
    from enn.reinforcement.training.training import Training

    for leftover in job.own_folder.glob(".*.tmp"):
        leftover.unlink()
    environment = partial(job.task.training_environment, observation=ROADMAP_KEYS, observe_every=settings.action_repeat)
    SHELF.capacity = max(SHELF.capacity, len(job.anatomies) + len(job.validated))  # all take turns
    make_validation_env = partial(environment, job.validated, accuracy="accurate")
    training = Training(
        replace(settings, device=report.device),
        partial(environment, job.anatomies),
        job.own_folder,
        seed=job.seed,
        demonstrations=read_demonstrations(job.folder / DEMONSTRATIONS, job.anatomies),
        metadata={**job.origin.configuration("training"), TASK: asdict(job.task.task)},
        starts=read_starts(job.folder / STARTS, job.anatomies, job.task.targets),
        make_validation_env=make_validation_env,
        after_evaluation=training_films(job.own_folder, make_validation_env, job.seed),
        initial=None if job.start is None else Policy.load(job.start, report.device),
    )
    with stopping_the_stage(CheckpointError, *([ValueError] if job.start is not None else [])):
        result = training.run(lambda progress: report(0.7 * progress.decisions / progress.total, words(progress)))
    return result.policy, result.timings["wall_s"]
