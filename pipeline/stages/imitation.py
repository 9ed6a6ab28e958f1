"""The imitation stage: the expert's episodes learnt from with the image alone, by behaviour cloning and by DAgger."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.anatomies.settings import check_anatomies, settle
from pipeline.evaluations.tables import log_summary
from pipeline.jobs.pool import Job, run_jobs
from pipeline.plots.imitation import draw_success
from pipeline.recording.trials import Origin
from pipeline.settings.checks import require_modalities
from pipeline.stages import Stage, StageContext
from pipeline.stages.gpu_memory import LEARNT_BATCH, policy_gb
from pipeline.stages.learning.aids import imitation_note
from pipeline.stages.learning.expert_episodes import expert_folder, expert_logs, read_episodes, require_expert
from pipeline.stages.learning.imitation import PRELOAD, ImitationJob, imitate
from pipeline.stages.learning.settings import ImitationSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.tables import Figure, Results
from pipeline.task import require_known_task

CLONED, DISTURBED, DAGGER = "image_w_enn", "image_w_enn_disturbed", "dagger"
GROUP = "Imitation"


def check_imitation(settings: ImitationSettings) -> None:
    """Refuses unknown phantoms and modality sets.

    Raises:
        ConfigurationError: listing the valid names.
    """
    check_anatomies(settings)
    require_modalities(settings.expert)
    require_known_task(settings.task)


def run_imitation(settings: ImitationSettings, context: StageContext) -> Results:
    """Fits and evaluates every student."""
    jobs = plan(settings, context)
    outcomes = run_jobs(
        context.folder, jobs, workers=settings.workers, label="students", preload=PRELOAD, device=settings.device
    )
    tables = {
        "bc_architecture": architecture(),
        "bc_hyperparameters": hyperparameters(settings),
        "imitation_episodes": by_episodes(jobs, outcomes),
        "dagger_rounds": by_round(jobs, outcomes),
    }
    log_summary(context.path)
    return Results(
        {name: table for name, table in tables.items() if table},
        figures(jobs, outcomes, context.path),
        {"imitation": imitation_note(job.given for job in jobs)},
    )


def plan(settings: ImitationSettings, context: StageContext) -> list[Job]:
    """The students: a task and number of episodes each, then those with disturbed episodes and by DAgger.

    Raises:
        StageError: the stage enn left no expert or no episodes of a task, or episodes of several kinds.
    """
    from enn.imitation.behaviour_cloning import cloning_settings
    from enn.imitation.dagger import DaggerSettings

    jobs = []
    cloning = cloning_settings(
        settings.variant, tuple(settings.observations), settings.feature_matching, settings.epochs
    )
    gpu_gb = policy_gb(settings.task.image_size_px, len(settings.observations), LEARNT_BATCH)
    for phantom in settings.phantoms:
        for target in settings.targets:
            task = LearningTask(phantom, target, settings.task, settings.anatomy_file)
            expert = expert_folder(context.inputs["enn"], task.name, settings.expert)
            logs = expert_logs(expert)
            read_episodes(logs, 1)  # an empty folder is refused before any work
            require_expert(settings.name, task, expert)
            most = min(settings.episodes[-1], len(logs))
            counts = sorted({min(count, most) for count in settings.episodes})
            rows: list[tuple[str, int, int, DaggerSettings | None]] = [
                (_row(count, most), count, 0, None) for count in counts
            ]
            if settings.disturbed_episodes:
                rows.append((DISTURBED, most, settings.disturbed_episodes, None))
            if settings.dagger_rounds:
                rows.append((DAGGER, counts[0], 0, DaggerSettings(settings.dagger_rounds, settings.dagger_episodes)))
            for row, count, disturbed, rounds in rows:
                given = ImitationJob(
                    folder=context.path / task.name / row / f"seed{context.seed}",
                    origin=Origin(settings.name, row, context.seed, settings.variant),
                    settings=cloning,
                    task=task,
                    expert=expert,
                    episodes=count,
                    disturbed_episodes=disturbed,
                    rounds=rounds,
                    evaluation_episodes=settings.evaluation_episodes,
                    drawn_episodes=settings.drawn_episodes,
                )
                weight = count + 3.0 * (disturbed + (rounds.rounds + rounds.episodes if rounds else 0))
                jobs.append(Job(f"{task.name}/{row}", imitate, given, weight=weight, gpu_gb=gpu_gb))
    return jobs


def _row(count: int, most: int) -> str:
    return CLONED if count == most else f"{CLONED}_{count}"


def architecture() -> dict[str, dict[str, Any]]:
    """The layers of the thesis's network as it is built here, in the thesis's table."""
    from enn.imitation.cloned_policy import CloningNetwork, CloningNetworkSettings
    from enn.networks.features import LAYER_COLUMNS, layer_table

    layers = CloningNetwork(CloningNetworkSettings(variant="thesis")).layers()
    return {
        row: dict(zip(LAYER_COLUMNS, cells, strict=True)) for row, cells in layer_table(layers, (1, 80, 80)).items()
    }


def hyperparameters(settings: ImitationSettings) -> dict[str, dict[str, Any]]:
    """What the students were fitted with."""
    from enn.imitation.behaviour_cloning import cloning_preset

    used = cloning_preset(settings.variant)
    values = {
        "batch_size": used.fit.batch_size,
        "optimizer": "Adam" if used.fit.weight_decay == 0 else "AdamW",
        "learning_rate": used.fit.learning_rate,
        "ent_coef": used.entropy,
        "epochs": settings.epochs or used.fit.epochs,
        "feature_matching": settings.feature_matching,
    }
    return {name: {"value": value} for name, value in values.items()}


def by_episodes(jobs: Sequence[Job], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Success against number of episodes.

    Returns:
        Row ``phantom/target/episodes`` to success in % of the deterministic episodes.
    """
    table = {}
    for job in jobs:
        if job.given.disturbed_episodes or job.given.rounds:
            continue
        task, outcome = job.key.rpartition("/")[0], outcomes[job.key]
        row = f"{task}/{outcome['episodes']} episodes"
        table[row] = {"success_pct": outcome["deterministic"]["success_pct"], "n": outcome["deterministic"]["n"]}
    return table


def by_round(jobs: Sequence[Job], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The result of each round of DAgger.

    Returns:
        Row ``phantom/target/round k`` to success of the student's roll-outs and distance to the expert's actions.
    """
    table = {}
    for job in jobs:
        for index, done in enumerate(outcomes[job.key]["rounds"]):
            table[f"{job.key.rpartition('/')[0]}/round {index + 1}"] = dict(done)
    return table


def figures(jobs: Sequence[Job], outcomes: dict[str, Any], folder: Path) -> list[Figure]:
    """Draws success against number of episodes into the stage's folder."""
    curves: dict[str, list[tuple[int, float, int]]] = {}
    beside: dict[str, list[tuple[str, float]]] = {}
    for job in jobs:
        task, outcome = job.key.rpartition("/")[0], outcomes[job.key]
        share = outcome["deterministic"]["success_pct"]
        if job.given.disturbed_episodes or job.given.rounds:
            beside.setdefault(task, []).append((job.given.origin.row, share))
        else:
            curves.setdefault(task, []).append((outcome["episodes"], share, outcome["deterministic"]["n"]))
    draw_success(curves, beside, folder / "success.png")
    return [
        Figure(
            "Imitation by number of expert episodes",
            "Behaviour cloning from the image alone: deterministic episodes on held-out starts, with 95 % intervals.",
            "success.png",
            GROUP,
        )
    ]


STAGE = Stage(
    settings=ImitationSettings,
    run=run_imitation,
    reads=("enn",),
    prepare=settle,
    check=check_imitation,
    repeated=True,
)
