"""Training jobs: one policy of a learning stage up to its logged episodes on held-out seeds, in one folder a mode.

A training's folder, ``<phantom>/<target>/<row>/seed<k>/``, holds::

    policy.pt  training.csv  training.json        what was trained, and how it went
    tensorboard/                                  its curves
    evaluation/{deterministic,stochastic}/NNN.mcap
    expert/NNN.mcap                               with images: what imitation learns from
    checkpoint/                                   until the training is finished
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import OPTIMISER, Report
from pipeline.recording.replay import ReplayError, recorded_devices, replay
from pipeline.recording.trials import MODES, Controller, Origin, controllers, run_trials, summary
from pipeline.seeds import expert_seeds, held_out_seeds
from pipeline.stages.learning.expert_episodes import EXPERT, readable
from pipeline.stages.learning.task import ACCURACY_OF_TESTS, LearningTask
from pipeline.store.errors import stopping_the_stage
from pipeline.task import FEEDER, TASK

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from enn.reinforcement import Progress, TrainingSettings
    from enn.trajectory import Trajectory


EVALUATION = "evaluation"


def evaluate(
    environment: NavigateEnv,
    controllers: Callable[[str], Callable[[int], Controller]],
    folder: Path,
    origin: Origin,
    episodes: Mapping[str, int],
    report: Callable[[float, str], None],
) -> dict[str, Any]:
    """Records held-out episodes that lack, so many a mode, in ``evaluation/<mode>``; mode to the summary of them."""
    outcome = {}
    total = sum(episodes.values())
    begun = 0
    for mode, count in episodes.items():

        def tell(share: float, text: str, begun: int = begun, count: int = count, mode: str = mode) -> None:
            report((begun + share * count) / total, f"{mode} {text}")

        metrics = run_trials(
            environment,
            controllers(mode),
            folder / EVALUATION / mode,
            seeds=held_out_seeds(origin.training_seed, count),
            mode=mode,
            origin=origin,
            report=tell,
        )
        outcome[mode] = summary(metrics)
        begun += count
    return outcome


def both_modes(best: int, drawn: int) -> dict[str, int]:
    """Mode to number of episodes: by the best action, and, where there are any, by drawn ones."""
    return {mode: count for mode, count in zip(MODES, (best, drawn), strict=True) if count}


RECORD, CURVE = "training.json", "training.csv"
# What every job imports: once, before the jobs' processes are forked.
PRELOAD = ("cathsim", "enn.reinforcement.training.training", "enn.encoder", "pipeline.recording.record", OPTIMISER)
_SECONDS_A_STEP = 1.3e-3  # of a logged episode; only for the estimate of the end
_SECONDS_A_DECISION = 1e-2


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
    encoder: Path | None = None  # file of a fitted encoder; None: the policy sees the observations themselves
    demonstrations: tuple[Path, ...] = ()
    expert_episodes: int = 0  # with images, for imitation

    @property
    def name(self) -> str:
        """Its folder below the stage's: ``type_1/bca/I+V+M/seed0``."""
        return f"{self.task.name}/{self.origin.row}/seed{self.origin.training_seed}"

    @property
    def weight(self) -> float:
        """Guess of its seconds, beside other jobs."""
        steps = (self.tested + self.expert_episodes) * self.task.task.max_steps / 3
        return self.settings.decisions * _SECONDS_A_DECISION + steps * _SECONDS_A_STEP

    @property
    def tested(self) -> int:
        """Episodes of both modes."""
        return self.evaluation_episodes + self.drawn_episodes


def train_and_evaluate(job: PolicyTrainingJob, report: Report) -> dict[str, Any]:
    """Trains, evaluates on held-out seeds, and records expert episodes, each where it lacks: times and summaries."""
    from enn.encoder import Encoder
    from enn.reinforcement import CheckpointError, Training

    for leftover in job.folder.glob(".*.tmp"):  # of a killed training
        leftover.unlink()
    trained = job.settings.decisions * _SECONDS_A_DECISION / max(job.weight, 1e-9)  # share of the job, by time
    training = Training(
        replace(job.settings, device=report.device),
        job.task.factory(job.keys, job.settings.action_repeat),
        job.folder,
        seed=job.origin.training_seed,
        demonstrations=[] if (job.folder / RECORD).is_file() else _demonstrations(job),
        encoder=None if job.encoder is None else Encoder.load(job.encoder),
        metadata={
            **job.origin.configuration("training"),
            "phantom": job.task.phantom,
            "target": job.task.target,
            TASK: asdict(job.task.task),
        },
        # a policy may get stuck in accurate physics alone: those choose the best one
        make_validation_env=replace(job.task, accuracy=ACCURACY_OF_TESTS).factory(job.keys, job.settings.action_repeat),
    )
    with stopping_the_stage(CheckpointError):
        result = training.run(lambda progress: report(trained * progress.decisions / progress.total, words(progress)))
    outcome: dict[str, Any] = {"training_s": result.timings["wall_s"], "decisions": result.timings["decisions"]}
    evaluated = trained + (1.0 - trained) * job.tested / (job.tested + job.expert_episodes)
    environment = job.task.environment(result.policy.keys)
    policies = functools.partial(controllers, result.policy)
    outcome |= evaluate(
        environment,
        policies,
        job.folder,
        job.origin,
        both_modes(job.evaluation_episodes, job.drawn_episodes),
        report.part(trained, evaluated),
    )
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


def words(progress: Progress) -> str:
    """Return and success of a training's latest episodes, and the success of its best policy, beside its bar."""
    gained = "" if progress.episode_return is None else f"return {progress.episode_return:.3g}"
    now = "" if progress.success is None else f"success {100 * progress.success:.0f} %"
    best = "" if progress.best_success is None else f"best {100 * progress.best_success:.0f} %"
    return ", ".join(filter(None, (gained, now, best)))


def _demonstrations(job: PolicyTrainingJob) -> list[Trajectory]:
    """The expert's episodes, as far as the training uses them."""
    learns = job.settings.learns_from_demonstrations
    if not (job.settings.reset_bank_share or learns):
        return []
    return repeat(job.demonstrations, job.task, job.keys if learns else ())


def repeat(logs: Sequence[Path], task: LearningTask, observation: tuple[str, ...] = ()) -> list[Trajectory]:
    """Repeats an expert's episodes; one that cannot be used is left out with a warning, those of tip motors, too."""
    if task.task.actions != FEEDER:
        return []

    def again(log: Path) -> Trajectory:
        with EpisodeReader(log) as reader:
            if recorded_devices(reader.info) != task.task.devices():
                raise ReplayError(f"it was recorded with another wire or catheter than {task.task.device_names}")
        return replay(
            log,
            observation,
            image_size=task.task.image_size_px,
            reward=task.reward,
            force_penalty=task.force_penalty,
            path_penalty=task.path_penalty,
        )

    return list(readable(logs, again))
