"""Force jobs: disturbed episodes of the expert, networks that learn forces from them, and forces from the shape."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from enn.curves import Curves
from pipeline.jobs.worker import Report
from pipeline.recording.record import record_episode
from pipeline.recording.trials import recorded
from pipeline.seeds import force_seed
from pipeline.stages.learning.expert_episodes import load_expert, read_episodes
from pipeline.stages.learning.task import LearningTask
from pipeline.store.errors import stopping_the_stage

if TYPE_CHECKING:
    from enn.fitting import EpisodeFitProgress
    from enn.force.prediction import ForcePredictionSettings
    from enn.force.samples import ForceSamples
    from enn.imitation.dagger import DisturbanceSettings
    from enn.trajectory import Trajectory


OPERATOR = "disturbed_policy"
PREDICTOR = "predictor.pt"
TEST_EVERY = 4  # of the episodes, one in so many is not learnt from

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordingJob:
    """Disturbed episodes of one task."""

    folder: Path  # gets ``000.mcap``, ``001.mcap``, …
    settings: DisturbanceSettings
    task: LearningTask
    expert: Path  # folder of the policy that steers
    steps: int  # to be recorded at least
    seed: int


@dataclass(frozen=True)
class ForceJob:
    """A network to fit."""

    folder: Path
    settings: ForcePredictionSettings
    logs: tuple[Path, ...]  # folders of the disturbed episodes
    expert: Path  # folder of the policy whose features are matched, in the episodes of every target
    inputs: str  # a key of `enn.force.FORCE_INPUTS`
    samples: int  # to learn from
    test_samples: int  # to test with, at most
    seed: int


def record_disturbed(job: RecordingJob, report: Report) -> dict[str, Any]:
    """Records disturbed episodes until there are enough ``steps``; those that are there are kept."""
    from enn.imitation.dagger import Disturbed

    expert = load_expert(job.expert, report.device)
    environment = job.task.environment(expert.keys)
    configuration = {"stage": "force", "mode": "demonstration", "noise": job.settings.noise,
                     "spell_chance": job.settings.spell_chance}  # fmt: skip
    steps = episode = 0
    while steps < job.steps:
        path, seed = job.folder / f"{episode:03d}.mcap", force_seed(job.seed, episode)
        generator = np.random.default_rng((job.seed, episode))
        actor = Disturbed(lambda observation, info: expert.act(observation), generator, job.settings)
        metrics = recorded(path, seed) or record_episode(
            environment, actor, path, seed=seed, operator=OPERATOR, configuration=configuration
        )
        steps += metrics.steps
        episode += 1
        report(steps / job.steps, f"{steps} steps")
    environment.close()
    return {"steps": steps, "episodes": episode}


def learn_force(job: ForceJob, report: Report) -> dict[str, Any]:
    """Fits a network and tests it on other episodes: `evaluate_predictor`, ``samples``, times, ``loss``."""
    from enn.fitting import FitError
    from enn.force.evaluation import evaluate_predictor
    from enn.force.prediction import fit_force

    began, worked = time.monotonic(), time.process_time()
    training, test = samples_of(job, report.device)

    def tell(now: EpisodeFitProgress) -> None:
        curves.add(now.epoch, loss=now.loss, validation=now.validation)
        report(now.epoch / (now.epochs + 1), f"epoch {now.epoch}, loss {now.loss:.3f}")

    with Curves(job.folder) as curves, stopping_the_stage(FitError):
        predictor, fitted = fit_force(
            training, job.settings, seed=job.seed, folder=job.folder / "fit", device=report.device, progress=tell
        )
    predictor.metadata |= {"inputs": job.inputs, "samples": len(training)}
    predictor.save(job.folder / PREDICTOR)
    return {
        "samples": len(training),
        **evaluate_predictor(predictor, training, test, seed=job.seed),
        "cpu_s": time.process_time() - worked,
        "wall_s": time.monotonic() - began,
        "loss": fitted.rows[-1]["loss"],
    }


def samples_of(job: ForceJob, device: str = "cpu") -> tuple[ForceSamples, ForceSamples]:
    """The samples of a fit to learn from, with the features to match, and those to test on."""
    from enn.force.samples import FORCE_INPUTS, training_and_test_samples

    groups = [read_episodes(sorted(folder.glob("*.mcap"))) for folder in job.logs]
    inputs = FORCE_INPUTS[job.inputs]
    expert = load_expert(job.expert, device) if inputs.matched else None
    training, test = training_and_test_samples(groups, inputs, expert, TEST_EVERY)
    if len(training) < job.samples:
        _LOGGER.warning("%d samples were asked for, the episodes have %d", job.samples, len(training))
    return (
        training.drawn(min(job.samples, len(training)), job.seed),
        test.drawn(min(job.test_samples, len(test)), job.seed),
    )


@dataclass(frozen=True)
class ShapeForceJob:
    """Contact forces of the test frames, estimated by `cathsim.statics`."""

    phantom: str
    logs: tuple[Path, ...]  # folders of the disturbed episodes
    test_samples: int  # at most
    seed: int
    # whether the curve has noise of 0.5 mm, and stiffness, feeder and lumen errors; drawn for each episode
    disturbed: bool


def forces_from_shape(job: ShapeForceJob, report: Report) -> dict[str, Any]:
    """Estimates test frames' resultant contact forces from the wire's points and feeder; refused curves have none."""
    from enn.force.evaluation import score

    worked = time.process_time()
    estimated, true, refused = estimated_and_true(job, report)
    result = score(estimated, true)
    return {
        "test_samples": result.samples,
        "mse_n2": result.mse_n2,
        "variance_n2": result.variance_n2,
        "share_pct": 100.0 * result.share_of_variance if result.variance_n2 > 0 else None,
        "correlation": result.correlation,
        "refused": refused,
        "cpu_s": time.process_time() - worked,
    }


def estimated_and_true(job: ShapeForceJob, report: Report) -> tuple[NDArray[np.float64], NDArray[np.float32], int]:
    """Estimated and true forces, (N,) N, of the test frames in the order of `samples_of`, and how many were refused."""
    from cathsim import load_phantom
    from cathsim.statics.shape_series import forces_of_shapes
    from enn.force.samples import split_episodes

    groups = [read_episodes(sorted(folder.glob("*.mcap"))) for folder in job.logs]
    episodes = [episode for group in groups for episode in split_episodes(group, TEST_EVERY)[1]]
    phantom, parts, refused = load_phantom(job.phantom), [], 0
    for number, episode in enumerate(episodes):
        generator = np.random.default_rng((job.seed, number)) if job.disturbed else None
        shapes = episode.observations["shape"].astype(float)
        forces, out = forces_of_shapes(shapes, _feeders(episode), episode.metadata["devices"], phantom, generator)
        parts.append(forces[1:])  # the first is the state after the reset, in which no step has ended
        refused += out
        report((number + 1) / len(episodes), f"episode {number + 1} of {len(episodes)}")
    if refused:
        _LOGGER.warning("%d of %d curves were refused: their force is taken to be 0", refused, sum(map(len, parts)))
    estimated = np.concatenate(parts)
    true = np.concatenate([episode.forces for episode in episodes]).astype(np.float32)
    drawn = np.random.default_rng(job.seed).permutation(len(true))[: job.test_samples]
    return estimated[drawn], true[drawn], refused


def _feeders(episode: Trajectory) -> NDArray[np.float64]:
    """Insertion (m) and rotation (rad, without jumps) of each feeder in every moment. Shape (T + 1, feeders, 2)."""
    observed = episode.observations["feeder"].astype(float)
    columns = [observed[:, start : start + 3] for start in range(0, observed.shape[1] - 2, 3)]
    return np.stack(
        [np.column_stack((one[:, 0], np.unwrap(np.arctan2(one[:, 2], one[:, 1])))) for one in columns], axis=1
    )
