"""The guide3d stage: a bi-planar data set, generated or one's own, and the wires of its pairs in space."""

from __future__ import annotations

import logging
from itertools import groupby

import numpy as np

from guide3d.dataset.acquisition_split import PlannedAcquisition, plan_acquisitions
from guide3d.reconstruction.evaluation import Record
from pipeline.anatomies.settings import require_known_phantoms
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import PHANTOM
from pipeline.stages import Stage, StageContext
from pipeline.stages.guide3d.figures import (
    comparison_row,
    composition_table,
    reconstruction_figures,
    reconstruction_tables,
    sample_figure,
)
from pipeline.stages.guide3d.folder import Source, own_source
from pipeline.stages.guide3d.generator import DATASET, GenerationJob, assemble, generate
from pipeline.stages.guide3d.reconstruction import ReconstructionJob, gather, reconstruct_pairs
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.store.errors import ConfigurationError
from pipeline.tables import Results

PRELOAD = (
    *PHANTOM,
    "cathsim",
    "guide3d.dataset.dataset",
    "guide3d.reconstruction.reconstruction",
)
_PAIRS_A_JOB = 150

_LOGGER = logging.getLogger(__name__)


def check_guide3d(settings: Guide3dSettings) -> None:
    """Refuses unknown phantoms, and targets that one of them does not have."""
    if settings.root is not None:
        return
    require_known_phantoms(settings.phantoms)
    from cathsim import load_phantom
    from cathsim.planning.scripted_motions import arch_branches

    for name in settings.phantoms:
        known = arch_branches(load_phantom(name))
        unknown = [target for target in settings.targets if target not in known]
        if unknown:
            raise ConfigurationError(f"phantom {name} has no branch {unknown[0]!r}: choose from {', '.join(known)}")


def run_guide3d(settings: Guide3dSettings, context: StageContext) -> Results:
    """Generates a data set or takes one's own, reconstructs its wires and sums them up."""
    source = _generated(settings, context) if settings.root is None else own_source(settings, context.path)
    source.write(context.path)
    data = source.open(context.path)
    tables = {
        "guide3d_composition": composition_table(data),
        "datasets": comparison_row(data, simulated=settings.root is None),
    }
    records: list[Record] = []
    if data.camera_a is None:
        _LOGGER.warning("no camera files: nothing is reconstructed; give their folder by guide3d.calibration=PATH")
    else:
        jobs = _reconstructions(settings, context, source, len(data))
        run_jobs(context.folder, jobs, workers=settings.workers, label="reconstructions", preload=PRELOAD)
        records = gather(context.path, source, range(len(jobs)))
        tables |= reconstruction_tables(records)
    sample = sample_figure(data, context.path)
    figures = reconstruction_figures(data, records, context.path)
    return Results(tables, [*([sample] if sample else []), *figures])


def _generated(settings: Guide3dSettings, context: StageContext) -> Source:
    from cathsim import load_phantom

    # one pair of cameras for all phantoms, which all lie about the world's origin
    x, y, z = load_phantom(settings.phantoms[0]).bounds.mean(axis=0).tolist()
    centre = (x, y, z)
    planned = plan_acquisitions(settings.images, settings.pairs, settings.phantoms, settings.targets)
    jobs = [
        Job(
            f"acquisitions/{number}",
            generate,
            GenerationJob(context.path, own, settings, centre, context.seed),
        )
        for number, own in enumerate(_chunks(planned))
    ]
    run_jobs(context.folder, jobs, workers=settings.workers, label="acquisitions", preload=PRELOAD)
    assemble(context.path, planned, settings, centre)
    return Source(DATASET)


def _chunks(planned: list[PlannedAcquisition]) -> list[tuple[PlannedAcquisition, ...]]:
    """Acquisitions of one phantom and filling together: the still parts of their images are computed once."""

    def kind(one: PlannedAcquisition) -> tuple[str, bool]:
        return one.phantom, one.fluid

    chunks: list[list[PlannedAcquisition]] = []
    for _, group in groupby(sorted(planned, key=kind), key=kind):
        chunks.append([])
        for one in group:
            if chunks[-1] and sum(other.pairs for other in chunks[-1]) + one.pairs > _PAIRS_A_JOB:
                chunks.append([])
            chunks[-1].append(one)
    return [tuple(chunk) for chunk in chunks]


def _reconstructions(settings: Guide3dSettings, context: StageContext, source: Source, count: int) -> list[Job]:
    compared = frozenset(np.unique(np.linspace(0, count - 1, min(settings.compared, count)).astype(int)).tolist())
    parts = np.array_split(np.arange(count), -(-count // (4 * _PAIRS_A_JOB)))
    return [
        Job(
            f"reconstructions/{number}",
            reconstruct_pairs,
            ReconstructionJob(context.path, source, number, tuple(part.tolist()), compared, settings, context.seed),
        )
        for number, part in enumerate(parts)
    ]


STAGE = Stage(settings=Guide3dSettings, run=run_guide3d, version=2, check=check_guide3d)
