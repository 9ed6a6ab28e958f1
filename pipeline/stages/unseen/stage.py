"""The unseen stage: one policy for every target, trained on random anatomies, tested on those it has never seen.

Rows say what a policy sees. `roadmap`: the way, walls, wire, force and tip as the simulator has them; the rows
`roadmap <k>` are the curve's, each trained on k arches for equally many decisions. `image_true_mask`: images without
noise, the lumen always filled, and the simulator's own mask of the wire. `xray`: noisy X-ray images, no mask, and one
contrast run before the episode.
"""

from __future__ import annotations

from pipeline.anatomies.known import require_known_entry, require_known_phantoms, require_known_targets
from pipeline.anatomies.settings import settle
from pipeline.evaluations.tables import log_summary
from pipeline.jobs.pool import run_jobs
from pipeline.stages import Stage, StageContext
from pipeline.stages.unseen.jobs import PRELOAD
from pipeline.stages.unseen.plan import ROADMAP_TESTS, plan
from pipeline.stages.unseen.roadmap_training import policy_to_start_from
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.tables import curve, registration
from pipeline.stages.unseen.task import VARIETY
from pipeline.store.errors import ConfigurationError
from pipeline.tables import Results
from pipeline.task import require_feeder, require_known_task


def check_unseen(settings: UnseenSettings) -> None:
    """Refuses unknown phantoms, targets, wires and views.

    Raises:
        ConfigurationError: listing the valid names.
    """
    from cathsim import GUIDEWIRES
    from cathsim.fluoroscopy.projector import VIEWS

    policy_to_start_from(settings)
    require_known_targets(settings.targets)
    if settings.arches == VARIETY and settings.file is not None:
        raise ConfigurationError(f"stage.arches={VARIETY} tries policies in such arches alone: leave phantom.file out")
    if settings.file is None:
        require_known_phantoms(settings.phantoms)
        if settings.phantoms:
            require_known_targets(settings.tested_targets(), settings.phantoms)
        require_known_entry(settings.own_entry, settings.phantoms)
    wires = (*GUIDEWIRES, "softer", "stiffer")
    unknown = [name for name in settings.wires if name not in wires]
    if unknown:
        raise ConfigurationError(f"unknown wire {', '.join(map(repr, unknown))}: choose from {', '.join(wires)}")
    unknown = [name for name in settings.views if name not in VIEWS]
    if unknown:
        raise ConfigurationError(f"unknown view {', '.join(map(repr, unknown))}: choose from {', '.join(VIEWS)}")
    require_known_task(settings.task)
    require_feeder(settings.task, "unseen")


def run_unseen(settings: UnseenSettings, context: StageContext) -> Results:
    """Trains and tests every policy."""
    jobs = plan(settings, context.path, context.seed, context.budget)
    outcomes = run_jobs(
        context.folder,
        jobs,
        workers=settings.workers,
        label="anatomies and policies",
        preload=PRELOAD,
        device=settings.device,
    )
    tables = {"generalisation_curve": curve(jobs, outcomes)}
    if settings.registration_noise_mm:
        tables["registration"] = registration(settings, outcomes[ROADMAP_TESTS]["tests"])
    log_summary(context.path)
    return Results(tables)


STAGE = Stage(
    settings=UnseenSettings,
    run=run_unseen,
    prepare=settle,
    check=check_unseen,
    repeated=True,
)
