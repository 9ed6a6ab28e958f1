"""Training jobs: one policy of a learning stage up to its logged episodes on held-out seeds, in one folder a mode.

A training's folder, ``<phantom>/<target>/<row>/seed<k>/``, holds::

    policy.pt  training.csv  training.json        what was trained, and how it went
    tensorboard/ or wandb/  films/                its curves, by logger=…; with films=N an episode every N evaluations
    evaluation/{deterministic,stochastic}/NNN.mcap
    expert/NNN.mcap                               with images: what imitation learns from
    checkpoint/                                   until the training is finished
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.anatomies.settings import check_anatomies
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import POLICIES, Report
from pipeline.recording.training_films import training_films
from pipeline.recording.trials import MODES, Controller, Origin, controllers, log_success, run_trials, summary
from pipeline.seeds import expert_seeds, held_out_seeds
from pipeline.stages import StageContext
from pipeline.stages.job_memory import training_gb, training_gpu_gb
from pipeline.stages.learning.encoders import ENCODERS, EncodersJob, encoder_file, fit_encoders
from pipeline.stages.learning.expert_episodes import EXPERT, repeat, require_demonstrations
from pipeline.stages.learning.settings import LearningSettings
from pipeline.stages.learning.shared_training import CHECKPOINT, RECORD, SharedTraining, shared_training
from pipeline.stages.learning.task import ACCURACY_OF_TESTS, LearningTask
from pipeline.store.errors import stopping_the_stage
from pipeline.store.provenance import hash_file
from pipeline.task import FEEDER, TASK, require_known_task

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from enn.reinforcement.training.result import Progress
    from enn.reinforcement.training.settings import TrainingSettings
    from enn.trajectory import Trajectory

EVALUATION = "evaluation"


def evaluate(
    environment: NavigateEnv,
    controllers: Callable[[str], Callable[[int], Controller]],
    job: Any,
    report: Callable[[float, str], None],
) -> dict[str, Any]:
    """Records a job's held-out episodes that lack, by the best action and by drawn ones, in ``evaluation/<mode>``.

    Returns:
        Mode to the summary of its episodes, where there are any.
    """
    outcome = {}
    counts = job.evaluation_episodes, job.drawn_episodes
    begun, total = 0, sum(counts)
    for mode, count in zip(MODES, counts, strict=True):
        if not count:
            continue

        def tell(share: float, text: str, begun: int = begun, count: int = count, mode: str = mode) -> None:
            report((begun + share * count) / total, f"{mode} {text}")

        metrics = run_trials(
            environment,
            controllers(mode),
            job.folder / EVALUATION / mode,
            seeds=held_out_seeds(job.origin.training_seed, count),
            mode=mode,
            origin=job.origin,
            report=tell,
        )
        outcome[mode] = summary(metrics)
        begun += count
    return outcome


_TRAINED = 0.8  # share of a job's progress at the end of its training


@dataclass(frozen=True)
class PolicyTrainingJob:
    """A policy to train and to evaluate."""

    folder: Path
    origin: Origin  # row, seed and variant of the training; kept in the logs
    settings: TrainingSettings
    task: LearningTask
    keys: tuple[str, ...]
    evaluation_episodes: int  # by the best action
    drawn_episodes: int  # by drawn actions
    run: Path  # the run's folder, in which stages share trainings
    encoder: Path | None = None  # file of a fitted encoder; None: the policy sees the observations themselves
    demonstrations: tuple[Path, ...] = ()
    expert_episodes: int = 0  # with images, for imitation

    @property
    def name(self) -> str:
        """Its folder below the stage's: ``type_1/bca/I+V+M/seed0``."""
        return f"{self.task.name}/{self.origin.row}/seed{self.origin.training_seed}"

    @property
    def tested(self) -> int:
        """Episodes of both modes."""
        return self.evaluation_episodes + self.drawn_episodes


def train_and_evaluate(job: PolicyTrainingJob, report: Report) -> dict[str, Any]:
    """Trains, evaluates on held-out seeds, and records expert episodes, each where it lacks: times and summaries."""
    from enn.encoder import Encoder
    from enn.reinforcement.checkpoint import CheckpointError
    from enn.reinforcement.training.training import Training

    metadata = {
        **job.origin.configuration("training"),
        "phantom": job.task.phantom,
        "target": job.task.target,
        TASK: asdict(job.task.task),
    }
    for leftover in job.folder.glob(".*.tmp"):  # of a killed training
        leftover.unlink()
    shared = shared_by(job, report.device)
    begun = any((job.folder / name).exists() for name in (RECORD, CHECKPOINT))
    taken = shared is not None and not begun and shared.take(job.folder, metadata)
    # a policy may get stuck in accurate physics alone: those choose the best one
    validation = replace(job.task, accuracy=ACCURACY_OF_TESTS).factory(job.keys, job.settings.action_repeat)
    training = Training(
        replace(job.settings, device=report.device),
        job.task.factory(job.keys, job.settings.action_repeat),
        job.folder,
        seed=job.origin.training_seed,
        demonstrations=[] if (job.folder / RECORD).is_file() else _demonstrations(job),
        encoder=None if job.encoder is None else Encoder.load(job.encoder),
        metadata=metadata,
        make_validation_env=validation,
        after_evaluation=training_films(job.folder, validation, job.origin.training_seed),
    )
    with stopping_the_stage(CheckpointError):
        result = training.run(lambda progress: report(_TRAINED * progress.decisions / progress.total, words(progress)))
    if shared is not None and not taken and not begun:  # what was begun before may be of other code
        shared.offer(job.folder)
    outcome: dict[str, Any] = {"training_s": result.timings["wall_s"], "decisions": result.timings["decisions"]}
    evaluated = _TRAINED + (1.0 - _TRAINED) * job.tested / (job.tested + job.expert_episodes)
    environment = job.task.environment(result.policy.keys)
    policies = functools.partial(controllers, result.policy)
    outcome |= evaluate(environment, policies, job, report.part(_TRAINED, evaluated))
    if job.expert_episodes:
        run_trials(
            environment,
            policies(MODES[0]),
            job.folder / EXPERT,
            seeds=expert_seeds(job.origin.training_seed, job.expert_episodes),
            mode=MODES[0],
            origin=job.origin,
            pictures=True,
            report=report.part(evaluated, 1.0, "expert episodes"),
        )
    environment.close()
    return outcome


def shared_by(job: PolicyTrainingJob, device: str) -> SharedTraining | None:
    """The run's trainings of a job's definition; None where they cannot be told, as in an anatomy of a file."""
    if job.task.file is not None:
        return None
    definition = {
        "settings": asdict(job.settings),
        "task": asdict(job.task),
        "keys": job.keys,
        "seed": job.origin.training_seed,
        "encoder": None if job.encoder is None else hash_file(job.encoder),
        "demonstrations": [hash_file(log) for log in job.demonstrations],
        "device": device,
    }
    return shared_training(job.run, definition)


def words(progress: Progress) -> str:
    """Return and success of a training's latest episodes, and the success of its best policy, beside its bar."""
    gained = "" if progress.episode_return is None else f"return {progress.episode_return:.3g}"
    now = "" if progress.success is None else f"success {100 * progress.success:.0f} %"
    best = "" if progress.best_success is None else f"best {100 * progress.best_success:.0f} %"
    return ", ".join(filter(None, (gained, now, best)))


def _demonstrations(job: PolicyTrainingJob) -> list[Trajectory]:
    """The expert's episodes, as far as the training uses them."""
    learns = job.settings.learns_from_demonstrations
    if not (job.settings.start_state_buffer_share or learns):
        return []
    return repeat(job.demonstrations, job.task, job.keys if learns else ())


THESIS = "thesis"

_LOGGER = logging.getLogger(__name__)


def check_learning(settings: LearningSettings) -> None:
    """Refuses unknown phantoms, targets and wires."""
    check_anatomies(settings)
    require_known_task(settings.task)


def training_seeds(run_seed: int, count: int, most: int) -> range:
    """Seeds of a row's trainings, of which no row has more than `most`; those of different run seeds never meet."""
    return range(run_seed * most, run_seed * most + count)


def planned_training(
    settings: LearningSettings,
    context: StageContext,
    task: LearningTask,
    row: str,
    seed: int,
    keys: tuple[str, ...],
    training: TrainingSettings,
    *,
    expert_episodes: int = 0,
) -> PolicyTrainingJob:
    """The job of one training of a table; the variant "desk" sees through an encoder, unless it sees vectors alone."""
    from enn.networks.observation_spaces import COMPACT

    # too many, or too large a seed, are refused before any work
    held_out_seeds(seed, max(settings.evaluation_episodes, settings.drawn_episodes))
    expert_seeds(seed, expert_episodes)
    encoder = encoder_file(context.path / ENCODERS / task.phantom, keys)
    further = {"force_weight": task.force_penalty}
    return PolicyTrainingJob(
        folder=context.path / task.name / row / f"seed{seed}",
        origin=Origin(settings.name, row, seed, settings.variant, further),
        settings=training,
        task=task,
        keys=keys,
        encoder=None if settings.variant == THESIS or set(keys) <= set(COMPACT) else encoder,
        demonstrations=demonstrations(task, context) if settings.demonstrations else (),
        evaluation_episodes=settings.evaluation_episodes,
        drawn_episodes=settings.drawn_episodes,
        run=context.run_path,
        expert_episodes=expert_episodes,
    )


def task_of(
    settings: LearningSettings, phantom: str, target: str, *, algorithm: str = "sac", force_penalty: float = 0.0
) -> LearningTask:
    """The task of a training by "sac" or "ppo"; `force_penalty` is that of its reward, 1/N."""
    return LearningTask(
        phantom=phantom,
        target=target,
        task=settings.task,
        file=settings.anatomy_file if phantom == settings.file_name else None,
        reward=settings.reward,
        force_penalty=force_penalty,
        path_penalty=settings.path_penalty,
        accuracy=settings.ppo_accuracy if algorithm == "ppo" else settings.accuracy,
    )


def run_trainings(
    trainings: Sequence[PolicyTrainingJob],
    settings: LearningSettings,
    context: StageContext,
    *,
    beside: Sequence[Job] = (),
) -> dict[str, Any]:
    """Runs trainings, their encoders and, last, other jobs; name to `train_and_evaluate`'s result and ``encoder_s``."""
    _check_demonstrations(trainings, settings)
    size_px = settings.task.image_size_px
    encoded: dict[str, list[PolicyTrainingJob]] = {}
    for training in trainings:
        if training.encoder is not None:
            encoded.setdefault(_encoders_key(training), []).append(training)
    jobs = [_encoders(key, theirs, settings, context) for key, theirs in encoded.items()]
    for training in trainings:
        by_encoder = training.encoder is not None
        jobs.append(
            Job(
                training.name,
                train_and_evaluate,
                training,
                after=(_encoders_key(training),) if by_encoder else (),
                memory_gb=training_gb(training.task, training.keys, training.settings, encoded=by_encoder),
                gpu_gb=training_gpu_gb(size_px, training.keys, 0 if by_encoder else training.settings.batch_size),
            )
        )
    results = run_jobs(
        context.folder,
        [*jobs, *beside],
        workers=settings.workers,
        label=f"{settings.name} trainings",
        preload=POLICIES,
        device=settings.device,
    )
    log_success(results)
    outcomes = {}
    for training in trainings:
        encoder = training.encoder
        spent = 0.0 if encoder is None else float(results[_encoders_key(training)][encoder.stem]["wall_s"])
        outcomes[training.name] = {**results[training.name], "encoder_s": spent}
    return outcomes


def _check_demonstrations(trainings: Sequence[PolicyTrainingJob], settings: LearningSettings) -> None:
    """Warns of tasks without demonstrations, and refuses those of another wire; tip motors have none."""
    if not settings.demonstrations or settings.task.actions != FEEDER:
        return
    for training in {one.task.name: one for one in trainings if one.settings.start_state_buffer_share > 0}.values():
        require_demonstrations(settings.name, training.task, training.demonstrations)
        if not training.demonstrations:
            _LOGGER.warning(
                "there are no expert episodes of %s, so it is learnt without demonstrations: run stage expert with "
                "this phantom and target first",
                training.task.name,
            )


def _encoders_key(training: PolicyTrainingJob) -> str:
    return f"{ENCODERS}/{training.task.phantom}"


def _encoders(
    key: str, trainings: Sequence[PolicyTrainingJob], settings: LearningSettings, context: StageContext
) -> Job:
    """The encoders of a phantom, one a set of observations: they know nothing of targets, and seeds share them."""
    from enn.encoder import EncoderSettings

    sets, task = tuple(dict.fromkeys(training.keys for training in trainings)), trainings[0].task
    targets = settings.targets if settings.demonstrations else ()
    job = EncodersJob(
        folder=context.path / ENCODERS / task.phantom,
        task=task,
        sets=sets,
        settings=EncoderSettings(epochs=settings.encoder_epochs, seed=context.seed),
        samples=settings.encoder_samples,
        demonstrations=tuple(
            log for target in targets for log in demonstrations(replace(task, target=target), context)
        ),
    )
    gpu_gb = max(training_gpu_gb(settings.task.image_size_px, keys) for keys in sets)
    return Job(key, fit_encoders, job, gpu_gb=gpu_gb)


def demonstrations(task: LearningTask, context: StageContext) -> tuple[Path, ...]:
    """Logs of the sampling expert's episodes of a task."""
    return tuple(sorted((context.inputs["expert"] / task.name).glob("*.mcap")))
