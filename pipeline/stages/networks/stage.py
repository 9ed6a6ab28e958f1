"""What the stages that train networks on images share: a training a row, then tables and figures of all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pipeline.jobs.pool import Job, run_jobs
from pipeline.stages import StageContext
from pipeline.stages.gpu_memory import network_gb
from pipeline.stages.networks.settings import TrainingSettings
from pipeline.stages.networks.training import TrainingJob
from pipeline.tables import Figure, Results

PICTURES = ".cache/pictures"  # made again from the data set when needed

Tables = Callable[[Any, dict[str, Any]], dict[str, Any]]
Figures = Callable[[Any, dict[str, Any], StageContext], list[Figure]]


def training_job(
    network: str,
    learn: Callable[[TrainingJob, Any], Any],
    settings: TrainingSettings,
    context: StageContext,
    weight: float = 1.0,
) -> Job:
    """The job that trains one network, with a GPU for each of its processes.

    Args:
        network: name of the job and of its folder.
        weight: how long it takes beside the others.
    """
    given = TrainingJob(
        folder=context.path / network,
        guide3d=context.inputs["guide3d"],
        pictures=context.path / PICTURES,
        network=network,
        settings=settings,
        seed=context.seed,
    )
    gpu_gb = network_gb(network, settings.size)
    return Job(network, learn, given, weight=weight, gpu_gb=gpu_gb, gpus=settings.processes)


def cost_cells(outcome: dict[str, Any]) -> dict[str, Any]:
    """A network's size in millions of weights, and its training in epochs and minutes of processor time."""
    return {"parameters_m": outcome["parameters"] / 1e6, "epochs": outcome["epochs"], "cpu_min": outcome["cpu_min"]}


def train_and_compare(
    settings: TrainingSettings,
    context: StageContext,
    jobs: Sequence[Job],
    tables: Tables,
    figures: Figures,
    *,
    label: str,
    preload: Sequence[str],
) -> Results:
    """Trains every network and writes tables and figures.

    Args:
        tables: from settings and what the jobs left.
        figures: from settings, what the jobs left, and the context.
    """
    outcomes = run_jobs(
        context.folder, list(jobs), workers=settings.workers, label=label, preload=preload, device=settings.device
    )
    return Results(tables(settings, outcomes), figures(settings, outcomes, context))
