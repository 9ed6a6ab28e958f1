"""What the stages that train networks on images share: a training a row, then tables and figures of all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from pipeline.jobs.gpu_memory import network_gb
from pipeline.jobs.pool import Job, run_jobs
from pipeline.report.results import Figure, write_figures, write_results
from pipeline.stages import StageContext
from pipeline.stages.networks.settings import NetworkSettings
from pipeline.stages.networks.splineformer_settings import SplineformerSettings
from pipeline.stages.networks.training import TrainingJob

PICTURES = ".cache/pictures"  # made again from the data set when needed

Kind = TypeVar("Kind", bound=TrainingJob)
Tables = Callable[[list[str], dict[str, Any]], dict[str, Any]]
Figures = Callable[[list[str], dict[str, Any], StageContext], list[Figure]]


def training_job(
    kind: type[Kind], network: str, settings: NetworkSettings | SplineformerSettings, context: StageContext,
    **further: Any,
) -> Kind:  # fmt: skip
    """The training of one network.

    Args:
        kind: of job.
        network: row of the stage.
        settings: of the stage.
        context: likewise.
        further: fields that only one of the stages has.
    """
    return kind(
        folder=context.path / network,
        guide3d=context.inputs["guide3d"],
        pictures=context.path / PICTURES,
        network=network,
        size=settings.size,
        epochs=settings.epochs,
        split_seed=settings.split_seed,
        seed=context.seed,
        processes=settings.processes,
        **further,
    )


def on_gpus(network: str, settings: NetworkSettings | SplineformerSettings) -> dict[str, Any]:
    """What a training needs of GPUs, as fields of its job: one of them for each of its processes.

    Args:
        network: row of the stage.
        settings: of the stage.
    """
    return {"gpu_gb": network_gb(network, settings.size), "gpus": settings.processes}


def train_and_compare(
    settings: NetworkSettings,
    context: StageContext,
    jobs: Sequence[Job],
    tables: Tables,
    figures: Figures,
    *,
    label: str,
    preload: Sequence[str],
) -> None:
    """Trains every network and compares them.

    Args:
        settings: of the stage.
        context: where the data set lies and where to write.
        jobs: the trainings.
        tables: of rows and what their jobs left.
        figures: likewise.
        label: of the progress.
        preload: modules that the jobs need.
    """
    outcomes = run_jobs(
        context.folder, list(jobs), workers=settings.workers, label=label, preload=preload, device=settings.device
    )
    write_results(context.path, tables(settings.rows, outcomes))
    write_figures(context.path, figures(settings.rows, outcomes, context))
