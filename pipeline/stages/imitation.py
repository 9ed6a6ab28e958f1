"""The imitation stage: the expert's episodes learnt from with the image alone, by behaviour cloning and by DAgger."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.jobs.gpu_memory import LEARNT_BATCH, policy_gb
from pipeline.jobs.pool import Job, run_jobs
from pipeline.recording.trials import Origin
from pipeline.report.aids import imitation_note
from pipeline.report.learning.tables import tables_from_logs
from pipeline.report.plots.imitation import draw_success
from pipeline.report.results import Figure, write_figures, write_notes, write_results
from pipeline.settings.checks import require_modalities
from pipeline.stages import Stage, StageContext
from pipeline.stages.learning.expert_episodes import expert_folder, expert_logs, read_episodes, require_expert
from pipeline.stages.learning.imitation import PRELOAD, ImitationJob, imitate
from pipeline.stages.learning.settings import ImitationSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.phantoms import require_known_phantoms
from pipeline.task import require_known_task

CLONED, DISTURBED, DAGGER = "image_w_enn", "image_w_enn_disturbed", "dagger"
GROUP = "Imitation"


def check_imitation(settings: ImitationSettings) -> None:
    """Refuses unknown phantoms and modality sets.

    Raises:
        ConfigurationError: listing the valid names.
    """
    require_known_phantoms(settings.phantoms)
    require_modalities(settings.expert)
    require_known_task(settings.task)


def run_imitation(settings: ImitationSettings, context: StageContext) -> None:
    """Fits and evaluates every student and sums them up.

    Args:
        settings: of the stage.
        context: where the expert's episodes lie and where to write.
    """
    jobs = plan(settings, context)
    outcomes = run_jobs(
        context.folder, jobs, workers=settings.workers, label="students", preload=PRELOAD, device=settings.device
    )
    tables: dict[str, Any] = tables_from_logs(context.path)
    tables["bc_architecture"] = architecture(settings)
    tables["bc_hyperparameters"] = hyperparameters(settings)
    tables["imitation_episodes"] = by_episodes(jobs, outcomes)
    tables["dagger_rounds"] = by_round(jobs, outcomes)
    write_results(context.path, {name: table for name, table in tables.items() if table})
    write_notes(context.path, {"imitation": imitation_note(job.given for job in jobs)})
    write_figures(context.path, figures(jobs, outcomes, context.path))


def plan(settings: ImitationSettings, context: StageContext) -> list[Job]:
    """The students: a task and number of episodes each, then those with disturbed episodes and by DAgger.

    Args:
        settings: of the stage.
        context: likewise.

    Raises:
        StageError: the stage enn left no expert or no episodes of a task, or episodes of several kinds.
    """
    jobs = []
    for phantom in settings.phantoms:
        for target in settings.targets:
            learnt = LearningTask(phantom, target, settings.task)
            task = learnt.name
            expert = expert_folder(context.inputs["enn"], task, settings.expert)
            logs = expert_logs(expert)
            read_episodes(logs, 1)  # an empty folder is told before any work
            require_expert("imitation", learnt, expert)
            most = min(settings.episodes[-1], len(logs))
            counts = sorted({min(count, most) for count in settings.episodes})
            rows: list[tuple[str, int, dict[str, int]]] = [(_row(count, most), count, {}) for count in counts]
            if settings.disturbed_episodes:
                rows.append((DISTURBED, most, {"disturbed_episodes": settings.disturbed_episodes}))
            if settings.dagger_rounds:
                rounds = {"dagger_rounds": settings.dagger_rounds, "dagger_episodes": settings.dagger_episodes}
                rows.append((DAGGER, counts[0], rounds))
            gpu_gb = policy_gb(settings.task.image_size_px, len(settings.observations), LEARNT_BATCH)
            for row, count, further in rows:
                folder = context.path / task / row / f"seed{context.seed}"
                given = ImitationJob(
                    folder=folder,
                    task=learnt,
                    expert=expert,
                    seed=context.seed,
                    origin=Origin("imitation", row, context.seed, settings.variant),
                    observations=tuple(settings.observations),
                    episodes=count,
                    variant=settings.variant,
                    feature_matching=settings.feature_matching,
                    epochs=settings.epochs,
                    evaluation_episodes=settings.evaluation_episodes,
                    **further,
                )
                weight = count + 3.0 * sum(further.values())
                jobs.append(Job(f"{task}/{row}", imitate, given, weight=weight, gpu_gb=gpu_gb))
    return jobs


def _row(count: int, most: int) -> str:
    return CLONED if count == most else f"{CLONED}_{count}"


def architecture(settings: ImitationSettings) -> dict[str, dict[str, Any]]:
    """The layers of the thesis's network as it is built here, in the thesis's table.

    Args:
        settings: of the stage.
    """
    from enn.imitation.cloned_policy import CloningNetwork, CloningNetworkSettings
    from enn.networks.features import LAYER_COLUMNS, layer_table

    layers = CloningNetwork(CloningNetworkSettings(variant="thesis")).layers()
    return {
        row: dict(zip(LAYER_COLUMNS, cells, strict=True)) for row, cells in layer_table(layers, (1, 80, 80)).items()
    }


def hyperparameters(settings: ImitationSettings) -> dict[str, dict[str, Any]]:
    """What the students were fitted with.

    Args:
        settings: of the stage.
    """
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

    Args:
        jobs: of the stage.
        outcomes: of the jobs.

    Returns:
        Row ``phantom/target/episodes`` to success in % of the deterministic episodes.
    """
    table = {}
    for job in jobs:
        if job.given.disturbed_episodes or job.given.dagger_rounds:
            continue
        task, told = job.key.rpartition("/")[0], outcomes[job.key]
        row = f"{task}/{told['episodes']} episodes"
        table[row] = {"success_pct": told["deterministic"]["success_pct"], "n": told["deterministic"]["n"]}
    return table


def by_round(jobs: Sequence[Job], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What DAgger's rounds came to.

    Args:
        jobs: of the stage.
        outcomes: of the jobs.

    Returns:
        Row ``phantom/target/round k`` to success of the student's roll-outs and distance to the expert's actions.
    """
    table = {}
    for job in jobs:
        for index, told in enumerate(outcomes[job.key]["rounds"]):
            table[f"{job.key.rpartition('/')[0]}/round {index + 1}"] = dict(told)
    return table


def figures(jobs: Sequence[Job], outcomes: dict[str, Any], folder: Path) -> list[Figure]:
    """Draws success against number of episodes.

    Args:
        jobs: of the stage.
        outcomes: of the jobs.
        folder: of the stage.
    """
    curves: dict[str, list[tuple[int, float, int]]] = {}
    beside: dict[str, list[tuple[str, float]]] = {}
    for job in jobs:
        task, told = job.key.rpartition("/")[0], outcomes[job.key]
        share = told["deterministic"]["success_pct"]
        if job.given.disturbed_episodes or job.given.dagger_rounds:
            beside.setdefault(task, []).append((job.given.origin.row, share))
        else:
            curves.setdefault(task, []).append((told["episodes"], share, told["deterministic"]["n"]))
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
    writes=(
        "<phantom>/<target>/<row>/seed<k>/{policy.pt, training.csv, training.json}",
        "<phantom>/<target>/<row>/seed<k>/evaluation/{deterministic, stochastic}/NNN.mcap",
        "success.png",
        "results.json",
        "notes.json",
        "figures.json",
    ),
    check=check_imitation,
    place=7,
)
