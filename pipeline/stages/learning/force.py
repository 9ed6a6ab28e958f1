"""Force jobs: disturbed episodes of the expert, logged with images; and networks that learn forces from them."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.recording.record import record_episode
from pipeline.recording.trials import recorded
from pipeline.seeds import force_seed
from pipeline.stages.learning.expert_episodes import load_expert, read_episodes
from pipeline.stages.learning.task import LearningTask
from pipeline.store.atomic_files import write_json

if TYPE_CHECKING:
    from enn.force.samples import ForceSamples
    from enn.trajectory import Trajectory

PRELOAD = ("cathsim", "enn.force.prediction", "enn.policy", "enn.imitation.dagger", "pipeline.recording.record")
OPERATOR = "disturbed_policy"
RECORD, PREDICTOR = "force.json", "predictor.pt"
SHAPE_COMPONENTS = 24  # principal components of the wire's shape that are matched beside the expert's features
TEST_EVERY = 4  # of the episodes, one in so many is not learnt from

# What a network sees: image observations, number observations, frames, the action, and whether features are matched.
INPUTS: dict[str, tuple[tuple[str, ...], tuple[str, ...], int, bool, bool]] = {
    "V": (("image",), (), 1, False, True),
    "V_plain": (("image",), (), 1, False, False),
    "V3": (("image",), (), 3, False, True),
    "V+M": (("image", "mask"), (), 1, False, True),
    "I+V": (("image",), ("joints",), 1, False, True),
    "I+V_action": (("image",), ("joints",), 1, True, True),
    "I": ((), ("joints",), 1, False, False),
}

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordingJob:
    """Disturbed episodes of one task.

    Attributes:
        folder: gets ``000.mcap``, ``001.mcap``, …
        task: that they run in.
        expert: folder of the policy that steers.
        steps: to be recorded at least.
        noise: standard deviation added to its actions.
        spell_chance: that a spell of random, forward actions begins at a step.
        seed: of starts and disturbance.
    """

    folder: Path
    task: LearningTask
    expert: Path
    steps: int
    noise: float
    spell_chance: float
    seed: int


@dataclass(frozen=True)
class ForceJob:
    """A network to fit.

    Attributes:
        folder: of the network.
        logs: folders of the disturbed episodes.
        expert: folder of the policy whose features are matched, in the episodes of every target.
        inputs: a key of `INPUTS`.
        samples: to learn from.
        test_samples: to test with, at most.
        variant: "desk" or "thesis".
        epochs: 0: the variant's own.
        seed: of the fit and of the choice of samples.
    """

    folder: Path
    logs: tuple[Path, ...]
    expert: Path
    inputs: str
    samples: int
    test_samples: int
    variant: str
    epochs: int
    seed: int


def record_disturbed(job: RecordingJob, report: Report) -> dict[str, Any]:
    """Records disturbed episodes until there are enough steps; those that are there are kept.

    Args:
        job: what to record.
        report: takes the progress.

    Returns:
        ``steps`` and ``episodes``.
    """
    from enn.imitation.dagger import Disturbed

    expert = load_expert(job.expert, report.device)
    environment = job.task.environment(expert.keys)
    steps = episode = 0
    while steps < job.steps:
        path = job.folder / f"{episode:03d}.mcap"
        seed = force_seed(job.seed, episode)
        metrics = recorded(path, seed)
        if metrics is None:
            actor = Disturbed(
                lambda observation, info: expert.act(observation),
                np.random.default_rng((job.seed, episode)),
                noise=job.noise,
                spell_chance=job.spell_chance,
            )
            metrics = record_episode(
                environment,
                actor,
                path,
                seed=seed,
                operator=OPERATOR,
                configuration={"stage": "force", "mode": "demonstration", "noise": job.noise,
                               "spell_chance": job.spell_chance},
            )  # fmt: skip
        steps += metrics.steps
        episode += 1
        report(steps / job.steps, f"{steps} steps")
    environment.close()
    return {"steps": steps, "episodes": episode}


def learn_force(job: ForceJob, report: Report) -> dict[str, Any]:
    """Fits a network and tests it on episodes that it has not learnt from.

    Args:
        job: what to fit.
        report: takes the progress.

    Returns:
        Errors, variances, the calibration, and the errors of what it is compared with.
    """
    import torch

    from enn.force.prediction import ForceNetwork, ForcePredictor, calibration, fit_force, force_preset, score

    told = job.folder / RECORD
    if told.is_file() and (job.folder / PREDICTOR).is_file():
        return dict(json.loads(told.read_text(encoding="utf-8")))
    began, worked = time.monotonic(), time.process_time()
    learnt, tested = held_apart(job)
    training, test = (
        samples_of(job, learnt, seen_features=True, device=report.device),
        samples_of(job, tested, seen_features=False),
    )
    chosen = training.drawn(min(job.samples, len(training)), job.seed)
    if len(chosen) < job.samples:
        _LOGGER.warning("%d samples were asked for, the episodes have %d", job.samples, len(chosen))
    test = test.drawn(min(job.test_samples, len(test)), job.seed)
    preset = force_preset(job.variant)
    if job.epochs:
        preset = replace(preset, fit=replace(preset.fit, epochs=job.epochs))
    predictor, fitted = fit_force(
        chosen,
        preset,
        seed=job.seed,
        folder=job.folder / "fit",
        device=report.device,
        progress=lambda now: report(now.epoch / (now.epochs + 1), f"epoch {now.epoch}, loss {now.loss:.3f}"),
    )
    predicted = predictor.predict(test.images, test.vectors)
    result = score(predicted, test.forces)
    mean = np.full(len(test), float(chosen.forces.astype(np.float64).mean()))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(job.seed)
        fresh = ForceNetwork(predictor.network.settings)  # its scales are those of no data: newtons
    untrained = ForcePredictor(fresh.to(report.device)).predict(test.images, test.vectors)
    forces = test.forces.astype(np.float64)
    outcome = {
        "samples": len(chosen),
        "test_samples": result.samples,
        "mse_n2": result.mse_n2,
        "variance_n2": result.variance_n2,
        # forces that are all the same have none, e.g. where no episode touches the wall
        "share_pct": 100.0 * result.share_of_variance if result.variance_n2 > 0 else None,
        "correlation": result.correlation,
        "mean_mse_n2": score(mean, test.forces).mse_n2,
        "untrained_mse_n2": score(untrained, test.forces).mse_n2,
        "force_mean_n": float(forces.mean()),
        "force_p95_n": float(np.percentile(forces, 95)),
        "force_max_n": float(forces.max()),
        "calibration": {name: values.tolist() for name, values in calibration(predicted, forces).items()},
        "cpu_s": time.process_time() - worked,
        "wall_s": time.monotonic() - began,
        "loss": fitted.rows[-1]["loss"],
    }
    predictor.metadata |= {"inputs": job.inputs, "samples": len(chosen)}
    predictor.save(job.folder / PREDICTOR)
    write_json(told, outcome)
    return outcome


def held_apart(job: ForceJob) -> tuple[list[list[Trajectory]], list[list[Trajectory]]]:
    """The disturbed episodes of each task, learnt from and not.

    Args:
        job: of the fit.

    Returns:
        Training and test episodes, a list a task.
    """
    learnt, tested = [], []
    for folder in job.logs:
        episodes = read_episodes(sorted(folder.glob("*.mcap")))
        apart = [index % TEST_EVERY == TEST_EVERY - 1 for index in range(len(episodes))]
        if len(episodes) == 1:  # a budget this small tests on what it has learnt
            learnt.append(episodes)
            tested.append(episodes)
            continue
        if not any(apart):
            apart[-1] = True
        learnt.append([one for one, out in zip(episodes, apart, strict=True) if not out])
        tested.append([one for one, out in zip(episodes, apart, strict=True) if out])
    return learnt, tested


def samples_of(
    job: ForceJob, episodes: Sequence[list[Trajectory]], *, seen_features: bool, device: str = "cpu"
) -> ForceSamples:
    """Samples with what a network sees, and where wanted with what it is to match.

    Args:
        job: of the fit.
        episodes: a list a task.
        seen_features: whether the features to match are computed.
        device: where the expert computes them.
    """
    from enn.force.samples import force_samples, principal_components

    images, vectors, frames, actions, matched = INPUTS[job.inputs]
    features: list[np.ndarray] | None = None
    everything = [episode for of_task in episodes for episode in of_task]
    if matched and seen_features:
        shapes = principal_components([one.observations["shape"] for one in everything], SHAPE_COMPONENTS)
        expert = load_expert(job.expert, device)
        features = [
            np.concatenate((expert.features({key: one.observations[key] for key in expert.keys}), shape), axis=1)
            for one, shape in zip(everything, shapes, strict=True)
        ]
    return force_samples(everything, images=images, vectors=vectors, frames=frames, actions=actions, features=features)
