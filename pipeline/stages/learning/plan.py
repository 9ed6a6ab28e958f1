"""The plan of a learning stage: its trainings with their settings and folders, and the encoders that they share."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.training_memory import training_gb, training_gpu_gb
from pipeline.recording.trials import Origin
from pipeline.report.aids import training_note
from pipeline.report.results import write_notes
from pipeline.seeds import expert_seeds, held_out_seeds
from pipeline.stages import StageContext
from pipeline.stages.learning.expert_episodes import require_demonstrations
from pipeline.stages.learning.settings import LearningSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import PRELOAD, EncoderJob, TrainingJob, fit, train_and_evaluate
from pipeline.stages.phantoms import require_known_phantoms
from pipeline.store.errors import ConfigurationError
from pipeline.task import FEEDER, require_known_task

if TYPE_CHECKING:
    from enn.reinforcement.training import TrainingSettings

ENCODERS = "encoders"
THESIS = "thesis"
THESIS_TABLES = {"baselines": ("cathsim_results",), "enn": ("ablation", "training_time_h")}  # whose rows stand beside
_SECONDS_AN_ENCODER_SAMPLE = 3e-3
_LEAST_SHARE_BEFORE_LEARNING = 4  # a tiny budget still spends most of its decisions learning

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cell:
    """One training of a stage's table.

    Attributes:
        task: what is trained for.
        row: of the table.
        seed: of the training.
        keys: observations that the policy sees.
        settings: of the training.
        encoded: whether the policy sees them through an encoder.
        expert_episodes: to record of it.
    """

    task: LearningTask
    row: str
    seed: int
    keys: tuple[str, ...]
    settings: TrainingSettings
    encoded: bool
    expert_episodes: int = 0

    @property
    def name(self) -> str:
        """Its folder below the stage's, and its job's key."""
        return f"{self.task.name}/{self.row}/seed{self.seed}"


def check_learning(settings: LearningSettings) -> None:
    """Refuses unknown phantoms, targets and wires.

    Args:
        settings: of the stage.

    Raises:
        ConfigurationError: listing the valid names.
    """
    from pipeline.stages.expert import TARGETS

    require_known_phantoms(settings.phantoms)
    unknown = [name for name in settings.targets if name not in TARGETS]
    if unknown:
        raise ConfigurationError(f"unknown target {', '.join(map(repr, unknown))}: choose from {', '.join(TARGETS)}")
    require_known_task(settings.task)


def training_seeds(run_seed: int, count: int, most: int) -> range:
    """Seeds of a row's trainings; those of different run seeds never meet.

    Args:
        run_seed: seed of the run.
        count: trainings of the row.
        most: trainings of the row that has most.
    """
    return range(run_seed * most, run_seed * most + count)


def task_of(settings: LearningSettings, phantom: str, target: str, *, force_penalty: float = 0.0) -> LearningTask:
    """The task of a cell.

    Args:
        settings: of the stage.
        phantom: name of the anatomy.
        target: name of the target.
        force_penalty: of the training's reward, 1/N.
    """
    return LearningTask(
        phantom=phantom,
        target=target,
        task=settings.task,
        reward=settings.reward,
        force_penalty=force_penalty,
        path_penalty=settings.path_penalty,
    )


def sized(preset: TrainingSettings, decisions: int, settings: LearningSettings, **changed: Any) -> TrainingSettings:
    """A preset with a budget of its own.

    Args:
        preset: of the library.
        decisions: the budget.
        settings: of the stage.
        changed: further fields.
    """
    if preset.algorithm == "ppo":
        changed["n_steps"] = min(preset.n_steps, max(decisions // (2 * preset.n_envs), 16))
    else:
        changed["buffer_size"] = min(preset.buffer_size, max(decisions, 1))
    return replace(
        preset,
        decisions=decisions,
        learning_starts=min(preset.learning_starts, decisions // _LEAST_SHARE_BEFORE_LEARNING),
        evaluate_every=min(preset.evaluate_every, decisions),
        evaluation_episodes=min(preset.evaluation_episodes, settings.evaluation_episodes),
        curve_every=min(preset.curve_every, decisions),
        tensorboard=settings.tensorboard,
        **changed,
    )


def run_cells(
    cells: Sequence[Cell], settings: LearningSettings, context: StageContext, *, stage: str, beside: Sequence[Job] = ()
) -> dict[str, Any]:
    """Runs a stage's trainings and the encoders that they need.

    Args:
        cells: of its table.
        settings: of the stage.
        context: of the stage.
        stage: its name.
        beside: further jobs, which run last.

    Returns:
        A cell's name to what its training told.
    """
    _check_demonstrations(stage, cells, settings, context)
    size_px = settings.task.image_size_px
    encoders = _encoders([cell for cell in cells if cell.encoded], settings, context)
    jobs = [
        Job(key, fit, job, weight=job.samples * _SECONDS_AN_ENCODER_SAMPLE, gpu_gb=training_gpu_gb(size_px, job.keys))
        for key, job in encoders.items()
    ]
    for cell in cells:
        held_out_seeds(cell.seed, settings.evaluation_episodes)  # too many, or too large a seed: told before any work
        expert_seeds(cell.seed, cell.expert_episodes)
        encoder = _encoder_key(cell) if cell.encoded else None
        given = TrainingJob(
            folder=context.path / cell.name,
            task=cell.task,
            settings=cell.settings,
            observation=cell.keys,
            seed=cell.seed,
            origin=Origin(stage, cell.row, cell.seed, settings.variant, {"force_weight": cell.task.force_penalty}),
            encoder=None if encoder is None else encoders[encoder].file,
            demonstrations=demonstrations(cell.task, context) if settings.demonstrations else (),
            evaluation_episodes=settings.evaluation_episodes,
            expert_episodes=cell.expert_episodes,
        )
        jobs.append(
            Job(
                cell.name,
                train_and_evaluate,
                given,
                after=() if encoder is None else (encoder,),
                weight=given.weight,
                memory_gb=training_gb(cell.task, cell.keys, cell.settings, encoded=cell.encoded),
                gpu_gb=training_gpu_gb(size_px, cell.keys, 0 if cell.encoded else cell.settings.batch_size),
            )
        )
    jobs += beside
    results = run_jobs(
        context.folder,
        jobs,
        workers=settings.workers,
        label=f"{stage} trainings",
        preload=PRELOAD,
        device=settings.device,
    )
    note = training_note(job.given for job in jobs if isinstance(job.given, TrainingJob))
    write_notes(context.path, dict.fromkeys(THESIS_TABLES[stage], note))
    return {
        cell.name: {**results[cell.name], "encoder_s": results[_encoder_key(cell)]["wall_s"] if cell.encoded else 0.0}
        for cell in cells
    }


def _check_demonstrations(stage: str, cells: Sequence[Cell], settings: LearningSettings, context: StageContext) -> None:
    """Warns of tasks without demonstrations, and refuses those of another wire; tip motors have none."""
    tasks = {cell.task.name: cell.task for cell in cells if cell.settings.reset_bank_share > 0}
    for name, task in tasks.items():
        if not settings.demonstrations or task.task.actions != FEEDER:
            continue
        logs = demonstrations(task, context)
        require_demonstrations(stage, task, logs)
        if not logs:
            _LOGGER.warning(
                "there are no expert episodes of %s, so it is learnt without demonstrations: run stage expert with "
                "this phantom and target first",
                name,
            )


def _encoder_key(cell: Cell) -> str:
    return f"{ENCODERS}/{cell.task.phantom}/{'+'.join(cell.keys)}"


def _encoders(cells: Sequence[Cell], settings: LearningSettings, context: StageContext) -> dict[str, EncoderJob]:
    """One encoder a phantom and set of observations: it knows nothing of targets, and seeds share it."""
    return {
        _encoder_key(cell): EncoderJob(
            file=context.path / f"{_encoder_key(cell)}.pt",
            task=cell.task,
            keys=cell.keys,
            demonstrations=_of_every_target(cell.task, settings, context),
            samples=settings.encoder_samples,
            epochs=settings.encoder_epochs,
            seed=context.seed,
        )
        for cell in cells
    }


def _of_every_target(task: LearningTask, settings: LearningSettings, context: StageContext) -> tuple[Path, ...]:
    if not settings.demonstrations:
        return ()
    return tuple(log for target in settings.targets for log in demonstrations(replace(task, target=target), context))


def demonstrations(task: LearningTask, context: StageContext) -> tuple[Path, ...]:
    """Logs of the sampling expert's episodes of a task."""
    return tuple(sorted((context.inputs["expert"] / task.name).glob("*.mcap")))
