"""A tiny enn stage's folder: a policy with fresh weights and a few of its episodes, with images."""

import json
import pickle
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch

from pipeline.jobs.pool import Job
from pipeline.jobs.worker import Report
from pipeline.recording.record import record_episode
from pipeline.seeds import expert_seeds, held_out_seeds
from pipeline.stages import StageContext, load_stage
from pipeline.stages.learning.task import LearningTask
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.task import TASK as KEY
from pipeline.task import Task

TASK = LearningTask("type_1", "bca", Task(max_steps=6, start_jitter_mm=20.0))


def write_expert(folder: Path, *, episodes: int = 4, task: LearningTask = TASK) -> Path:
    """Writes a training's folder below that of the stage; returns it."""
    from enn.networks.network import NetworkSettings, build_network
    from enn.policy import Policy

    place = folder / task.name / "I+V+M" / "seed0"
    environment = task.environment(("feeder", "tip"))
    settings = NetworkSettings(keys=("feeder",), hidden=(8,))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = build_network(settings, environment.observation_space, environment.action_space)
    policy = Policy(
        settings, network, environment.observation_space, environment.action_space, metadata={KEY: asdict(task.task)}
    )
    policy.save(place / "policy.pt")
    generator = np.random.default_rng(0)
    for index in range(episodes):
        record_episode(
            environment,
            lambda observation, info: generator.uniform(-0.2, 1.0, 2).astype(np.float32),
            place / "expert" / f"{index:03d}.mcap",
            seed=expert_seeds(0, episodes)[index],
            operator="policy",
        )
    forward = np.array([1.0, 0.0], np.float32)
    log = place / "evaluation" / "deterministic" / "000.mcap"
    record_episode(environment, lambda *_: forward, log, seed=held_out_seeds(0, 1)[0], operator="policy")
    return place


def context(run: Path, stage: str, reads: Sequence[str] = ("enn",)) -> StageContext:
    """What a stage is given, below a run's folder."""
    folder = RunFolder(run / stage, Identity("a", {}, 1))
    folder.path.mkdir(parents=True, exist_ok=True)
    return StageContext(folder, run, {name: run / name for name in reads}, "smoke", 0)


def in_this_process(folder: RunFolder, jobs: Sequence[Job], **_: Any) -> dict[str, Any]:
    """Stands in for `run_jobs`: one after another, here, with what a process of their own would be given."""
    return {job.key: job.run(pickle.loads(pickle.dumps(job.given)), Report()) for job in jobs}


def run_here(settings: Any, run: Path, module: Any, reads: Sequence[str] = ("enn",)) -> dict[str, Any]:
    """Runs a stage below a run's folder with its jobs, which a module starts, in this process; gives its results."""
    place = context(run, settings.name, reads)
    with mock.patch.object(module, "run_jobs", in_this_process):
        results = load_stage(settings.name).run(settings, place)
    assert results is not None
    results.write(place.path)
    found: dict[str, Any] = json.loads((place.path / "results.json").read_text())
    return found
