"""A rehearsal's training, and the demonstrations that it learns from.

It trains from the policy that it starts from, and once more from its own while it seldom arrives. Demonstrations are
episodes in its training's copies in which some policy reached the target, turn by turn
(`enn.reinforcement.rehearsal_rules`); threads share the copies of a turn. The sampling expert plays copy by copy until
enough episodes have arrived. It presses gently, and plays as usual, too, where few of these episodes arrive.

One file an episode, ``demonstrations/<policy or expert>_<copy>_<turn>.npz`` (`pipeline.stages.unseen.roadmap`).
"""

from __future__ import annotations

import contextlib
import math
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report, map_simulations
from pipeline.recording.training_films import training_films
from pipeline.recording.trials import POLICY
from pipeline.seeds import rehearsal_demonstration_seed, validation_copies
from pipeline.stages.learning.training import words
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment, held_steps, threads_of, training_settings
from pipeline.stages.rehearsal.settings import PRESSING, SAC
from pipeline.stages.unseen.roadmap import ARRIVED, arrived, demonstration_arrays, read_demonstration
from pipeline.stages.unseen.task import ROADMAP_KEYS
from pipeline.store.atomic_files import atomic_path, write_arrays
from pipeline.store.costs import processor_s
from pipeline.store.errors import stopping_the_stage
from pipeline.task import TASK

if TYPE_CHECKING:
    import gymnasium

    from enn.imitation.dagger import Act
    from enn.imitation.images.policy import ImagePolicy
    from enn.policy import Policy
    from enn.reinforcement.evaluation import EvaluationResult
    from enn.reinforcement.rehearsal_rules import Turn
    from enn.reinforcement.training.result import Progress, TrainingResult
    from enn.reinforcement.training.settings import TrainingSettings
    from enn.trajectory import Trajectory

DEMONSTRATIONS = "demonstrations"  # job and folder
EXPERT = "expert"


def first_turn(job: RehearsalJob) -> list[bool]:
    """Where the policy that a rehearsal starts from arrives in its demonstrations; empty where it did not play all."""
    if job.start is None:
        return []
    files = [demonstration_file(job, job.start.stem, copy, 0) for copy in job.training_cases]
    return [arrived(file) for file in files] if all(file.is_file() for file in files) else []


def demonstration_file(job: RehearsalJob, name: str, copy: int, number: int) -> Path:
    """The file of an episode of a policy, or of the expert, in a copy and turn."""
    return job.folder / DEMONSTRATIONS / f"{name}_{copy}_{number}.npz"


def policy_names(job: RehearsalJob) -> dict[Path, str]:
    """Stems of the policies' files; where several have one, all but the first get a number."""
    names: dict[Path, str] = {}
    for path in job.demonstrators:
        alike = sum(other.stem == path.stem for other in names)
        names[path] = f"{path.stem}{alike + 1}" if alike else path.stem
    return names


PARTS = 2  # of the copies, beside each other
ENOUGH, LEAST = 6, 3  # episodes of the expert that arrive, in each part; fewer gentle ones: it plays as usual, too
STEPS = 100_000  # that the expert simulates for an episode at most
# Episodes of a gentle expert, of the usual one: it gives up where none of them arrives.
EXPERT_TRIALS = {True: 3, False: 2}


def demonstrate(job: RehearsalJob, report: Report) -> dict[str, list[int]]:
    """Lets policies and the expert play, turn by turn, each episode where it lacks: name to played, arrived."""
    from enn.reinforcement.resources import Workers

    map_simulations()
    turns = job.rules.turns(job.demonstrators, job.start, job.trial_statistics)
    names, counts, workers = policy_names(job), dict[str, list[int]](), Workers(PARTS)
    with contextlib.closing(workers):
        turn = next(turns, None)
        while turn is not None:
            name = EXPERT if turn.policy is None else names[turn.policy]
            play = partial(_expert_demonstrations if turn.policy is None else _policy_demonstrations, job, turn, report)
            arrivals = [one for part in workers.each(play, range(PARTS)) for one in part]
            played, arrived_before = counts.get(name, [0, 0])
            counts[name] = [played + len(arrivals), arrived_before + sum(arrivals)]
            try:
                turn = turns.send(arrivals)
            except StopIteration:
                turn = None
    return counts


def _policy_demonstrations(job: RehearsalJob, turn: Turn[Path], report: Report, part: int) -> list[bool]:
    """Whether a policy arrives in each of a part of the copies."""
    assert turn.policy is not None
    name, copies = policy_names(job)[turn.policy], job.training_cases
    cases = range(part, len(copies), PARTS)
    outcomes: list[bool] = []
    steered = None
    for case in cases:
        report(len(outcomes) / len(cases), f"{name}: {sum(outcomes)} of {len(outcomes)} episodes arrived")
        file = demonstration_file(job, name, copies[case], turn.number)
        if not file.is_file():
            steered = steered or _Steered(job, turn.policy, copies)
            write_arrays(file, demonstration_arrays(steered.episode(case, turn.number)))
        outcomes.append(arrived(file))
    if steered is not None:
        steered.environment.close()
    return outcomes


def _expert_demonstrations(job: RehearsalJob, turn: Turn[Path], report: Report, part: int) -> list[bool]:
    """Whether the sampling expert arrives in a part of the copies: usual episodes only where few gentle ones do."""
    cases = range(part, len(job.training_cases), PARTS)
    outcomes: list[bool] = []
    for number, gentle in enumerate((True, False)):
        outcomes += _episodes_of_expert(job, cases, number, gentle, report)
        if sum(outcomes) >= min(LEAST, len(cases)):
            break
    return outcomes


def _episodes_of_expert(
    job: RehearsalJob, cases: Sequence[int], number: int, gentle: bool, report: Report
) -> list[bool]:
    """Whether it arrived, case by case, until enough have, or none of the first."""
    from cathsim.planning.demonstration import demonstrate

    held, copies, outcomes = held_steps(job), job.training_cases, list[bool]()
    name = "expert, gently" if gentle else "expert"
    environment = copies_environment(job, copies, training=True, observe_every=held)
    for case in cases:
        if sum(outcomes) == ENOUGH or (len(outcomes) == EXPERT_TRIALS[gentle] and not any(outcomes)):
            break
        file = demonstration_file(job, EXPERT, copies[case], number)
        if not file.is_file():
            share, text = len(outcomes) / len(cases), f"{name}: {sum(outcomes)} of {len(outcomes)} episodes arrived"
            arrays = demonstrate(
                environment,
                case,
                ROADMAP_KEYS,
                hold=held,
                seed=rehearsal_demonstration_seed(job.origin.training_seed, number, case),
                rollouts=math.inf,
                steps=STEPS,
                gentle=gentle,
                tick=partial(report, share, text),
            )
            write_arrays(file, arrays if arrays[ARRIVED] else {ARRIVED: arrays[ARRIVED]})
        outcomes.append(arrived(file))
    environment.close()
    return outcomes


class _Steered:
    """A policy and the training's copies as it and the training observe them."""

    def __init__(self, job: RehearsalJob, path: Path, copies: Sequence[int]) -> None:
        from cathsim.observations.xray import XrayEnvironment
        from enn.policy import Policy
        from enn.shipped import read_policy

        with stopping_the_stage(ValueError):
            self.policy: Policy | ImagePolicy = read_policy(path)
        self.seed, held = job.origin.training_seed, self.policy.action_repeat
        self.environment: gymnasium.Env[Any, Any]
        if isinstance(self.policy, Policy):
            self.environment = copies_environment(job, copies, training=True, observe_every=held)
        else:
            keys = (*ROADMAP_KEYS, "goal_image")
            bare = copies_environment(job, copies, training=True, observe_every=held, observation=keys)
            side = int(self.policy.metadata[TASK]["image_size_px"])
            self.environment = XrayEnvironment(bare, side, every=held, **self.policy.imaging)

    def episode(self, case: int, number: int) -> Trajectory:
        from enn.policy import Policy
        from enn.reinforcement.rehearsal import demonstrated

        seed = rehearsal_demonstration_seed(self.seed, number, case)
        if isinstance(self.policy, Policy):
            controller: Act = self.policy.controller(deterministic=False, seed=seed)
        else:
            controller = self.policy.controller()
        return demonstrated(controller, self.environment, case, ROADMAP_KEYS, seed=seed)


def read_demonstrations(folder: Path) -> list[Trajectory]:
    """The demonstrations of a stage's folder that arrived, in the order of their files' names."""
    demonstrations = [read_demonstration(path) for path in sorted((folder / DEMONSTRATIONS).glob("*.npz"))]
    return [one for one in demonstrations if one is not None]


STARTS = "starts.npz"
FURTHER = "further"  # folder, in the training's, of each that goes on from it: further1, further2, ...
_INSERTED = 0.1  # of the training's job


def train(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Inserts the wire at start states and trains, each only where it lacks, and further while it seldom arrives.

    Returns times and decisions. A policy that always arrives, and presses gently, is kept as it is.
    """
    from enn.policy import Policy
    from enn.reinforcement.checkpoint import CheckpointError
    from enn.reinforcement.rehearsal import first_evaluation, rehearse
    from enn.reinforcement.rehearsal_rules import in_share

    map_simulations()
    settings, seed = job.settings, job.origin.training_seed
    rules, outcomes = job.rules, first_turn(job)
    begun = processor_s()
    copies = job.training_cases
    demonstrations = read_demonstrations(job.folder)
    validated = (0, *validation_copies(settings.validation_copies))
    results: list[TrainingResult] = []
    with stopping_the_stage(CheckpointError, ValueError):
        policy = None if job.start is None else Policy.load(job.start, report.device)
        environment = partial(copies_environment, job, observe_every=held_steps(job))
        may_be_fewer = settings.share_of_decisions < 1 and settings.algorithm == SAC
        always = in_share(outcomes, job.trial_statistics, 1.0)
        evaluations = rules.fewer_evaluations if may_be_fewer and always else None
        usual = training_settings(job, report.device, evaluations=evaluations)
        shorter = training_settings(job, report.device, fewer=True)
        metadata = {**job.origin.configuration("training"), TASK: asdict(job.task)}
        played: list[EvaluationResult] = []

        def elsewhere() -> list[bool]:
            assert policy is not None
            report(_INSERTED, "whether fewer decisions are enough")
            played.append(first_evaluation(policy, partial(environment, validated), usual, seed=seed))
            return [one.success for one in played[0].outcomes]

        def tell(progress: Progress) -> None:
            before = sum(result.timings["decisions"] for result in results)
            share = (before + progress.decisions) / (before + progress.total)
            report(_INSERTED + (1 - _INSERTED) * share, words(progress))

        def trained(start: Policy | None, training: TrainingSettings, folder: str, **further: Any) -> TrainingResult:
            return rehearse(
                partial(environment, copies, training=True),
                make_validation_env=partial(environment, validated),
                policy=start,
                settings=training,
                starts=starts,
                demonstrations=demonstrations,
                folder=job.own_folder / folder,
                seed=seed,
                metadata=metadata,
                after_evaluation=training_films(job.own_folder / folder, partial(environment, validated), seed),
                progress=tell,
                **further,
            )

        if policy is not None and evaluations and _gentle(demonstrations) and all(elsewhere()):
            policy.metadata |= metadata
            policy.save(job.own_folder / POLICY, critics=True)
            return _training_record(begun, [])
        starts = _inserted_start_states(job, copies, report)
        fewer = may_be_fewer and rules.mostly_arrives(outcomes, job.trial_statistics, elsewhere)
        first = played[0] if played else None
        results.append(trained(policy, shorter if fewer else usual, "", first_result=first))
        for number in range(1, settings.further_trainings + 1):
            if settings.algorithm != SAC or not rules.sometimes_arrives(results[-1]):
                break
            results.append(trained(results[-1].policy, shorter, f"{FURTHER}{number}"))
            with atomic_path(job.own_folder / POLICY) as path:
                shutil.copyfile(job.own_folder / f"{FURTHER}{number}" / POLICY, path)
    return _training_record(begun, results)


def _gentle(demonstrations: Sequence[Trajectory]) -> bool:
    """Whether a policy does not press too hard in its demonstrations."""
    return float(np.percentile(np.concatenate([episode.forces for episode in demonstrations]), 95)) <= PRESSING


def _training_record(begun: float, results: Sequence[TrainingResult]) -> dict[str, Any]:
    return {
        "cpu_s": round(processor_s() - begun, 1),
        "training_wall_s": round(sum(result.timings["wall_s"] for result in results), 1),
        "decisions": int(sum(result.timings["decisions"] for result in results)),
        "further_trainings": max(len(results) - 1, 0),
    }


def _inserted_start_states(job: RehearsalJob, copies: Sequence[int], report: Report) -> list[np.ndarray]:
    from enn.reinforcement.resources import Workers

    path = job.folder / STARTS
    if not path.is_file():
        threads = min(threads_of(job.settings), len(copies))
        environments = [copies_environment(job, copies, training=True) for _ in range(threads)]
        workers = Workers(threads)
        arrays: dict[str, np.ndarray] = {}
        for first in range(0, len(copies), threads):
            report(_INSERTED * first / len(copies), f"starts in copy {copies[first]}")
            cases = range(first, min(first + threads, len(copies)))
            inserted = workers.each(
                lambda case: environments[case % threads].inserted_starts(case, job.origin.training_seed), cases
            )
            arrays |= dict(zip(map(str, cases), inserted, strict=True))
        workers.close()
        for environment in environments:
            environment.close()
        write_arrays(path, arrays)
    with np.load(path) as content:
        return [states for name in content.files if len(states := content[name])]
