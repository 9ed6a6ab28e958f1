"""The plan of a learning stage: its trainings with their settings and folders, and the encoders that they share."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.anatomies.settings import check_anatomies
from pipeline.jobs.pool import Job, run_jobs
from pipeline.recording.trials import Origin
from pipeline.seeds import expert_seeds, held_out_seeds
from pipeline.stages import StageContext
from pipeline.stages.job_memory import training_gb, training_gpu_gb
from pipeline.stages.learning.encoders import ENCODERS, EncodersJob, encoder_file, fit_encoders
from pipeline.stages.learning.expert_episodes import require_demonstrations
from pipeline.stages.learning.settings import LearningSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import PRELOAD, PolicyTrainingJob, train_and_evaluate
from pipeline.task import FEEDER, require_known_task

if TYPE_CHECKING:
    from enn.reinforcement import TrainingSettings

THESIS = "thesis"
_SECONDS_AN_ENCODER_SAMPLE = 3e-3

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
    from enn.networks.features import COMPACT

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
                weight=training.weight,
                memory_gb=training_gb(training.task, training.keys, training.settings, encoded=by_encoder),
                gpu_gb=training_gpu_gb(size_px, training.keys, 0 if by_encoder else training.settings.batch_size),
            )
        )
    results = run_jobs(
        context.folder,
        [*jobs, *beside],
        workers=settings.workers,
        label=f"{settings.name} trainings",
        preload=PRELOAD,
        device=settings.device,
    )
    return {
        training.name: {**results[training.name], "encoder_s": _encoder_s(training, results)} for training in trainings
    }


def _check_demonstrations(trainings: Sequence[PolicyTrainingJob], settings: LearningSettings) -> None:
    """Warns of tasks without demonstrations, and refuses those of another wire; tip motors have none."""
    if not settings.demonstrations or settings.task.actions != FEEDER:
        return
    for training in {one.task.name: one for one in trainings if one.settings.reset_bank_share > 0}.values():
        require_demonstrations(settings.name, training.task, training.demonstrations)
        if not training.demonstrations:
            _LOGGER.warning(
                "there are no expert episodes of %s, so it is learnt without demonstrations: run stage expert with "
                "this phantom and target first",
                training.task.name,
            )


def _encoders_key(training: PolicyTrainingJob) -> str:
    return f"{ENCODERS}/{training.task.phantom}"


def _encoder_s(training: PolicyTrainingJob, results: Mapping[str, Any]) -> float:
    """Seconds that the encoder of a training took."""
    if training.encoder is None:
        return 0.0
    return float(results[_encoders_key(training)][training.encoder.stem]["wall_s"])


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
    return Job(key, fit_encoders, job, weight=len(sets) * job.samples * _SECONDS_AN_ENCODER_SAMPLE, gpu_gb=gpu_gb)


def demonstrations(task: LearningTask, context: StageContext) -> tuple[Path, ...]:
    """Logs of the sampling expert's episodes of a task."""
    return tuple(sorted((context.inputs["expert"] / task.name).glob("*.mcap")))
