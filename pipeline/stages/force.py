"""The force stage: contact forces learnt from disturbed episodes of the expert, or estimated from the shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.anatomies.settings import require_known_phantoms
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import POLICIES
from pipeline.plots.episodes import draw_calibration
from pipeline.settings.kinds import require_modalities
from pipeline.stages import Stage, StageContext
from pipeline.stages.job_memory import LEARNT_BATCH, policy_gb
from pipeline.stages.learning.aids import note_of, of_force
from pipeline.stages.learning.expert_episodes import expert_folder, require_expert
from pipeline.stages.learning.force import (
    TEST_EVERY,
    ForceJob,
    RecordingJob,
    ShapeForceJob,
    forces_from_shape,
    learn_force,
    record_disturbed,
)
from pipeline.stages.learning.settings import ForceSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.tables import Figure, Results
from pipeline.task import require_known_task

THESIS_INPUTS = "V"  # the image alone, with the loss on features and force
GROUP = "Force prediction"
# Episodes are drawn apart for the test, and their lengths vary: so much more is recorded than is learnt from.
_MORE_STEPS = 1.1 * TEST_EVERY / (TEST_EVERY - 1)
FRAMES = 3  # that a network sees at most
_SHARE = ("mse_n2", "variance_n2", "share_pct", "correlation", "cpu_s")  # columns of the detailed table
# Forces from the logged shape, without a network: row, and whether curve and what is known of the case have errors.
SHAPE_ROWS = {"shape": False, "shape_errors": True}


def check_force(settings: ForceSettings) -> None:
    """Refuses unknown phantoms and modality sets."""
    require_known_phantoms([settings.phantom])
    require_modalities(settings.expert)
    require_known_task(settings.task)


def run_force(settings: ForceSettings, context: StageContext) -> Results:
    """Records disturbed episodes, fits every network and sums them up."""
    recordings, fits, shapes = plan(settings, context)
    outcomes = run_jobs(
        context.folder,
        [*recordings, *fits, *shapes],
        workers=settings.workers,
        label="force jobs",
        preload=POLICIES,
        device=settings.device,
    )
    rows = {f"{job.given.inputs}, {job.given.samples:,} samples": of_force(job.given, settings.task) for job in fits}
    notes = {"force_prediction_mse": note_of(rows)}
    return Results(tables(fits, outcomes, shapes), figures(fits, outcomes, context.path), notes)


def plan(settings: ForceSettings, context: StageContext) -> tuple[list[Job], list[Job], list[Job]]:
    """The recordings, a target each, then the fits and the estimates from the logged shape, which wait for them."""
    from enn.force.prediction import force_preset
    from enn.imitation.dagger import DisturbanceSettings

    steps = int(max(settings.samples[-1] * _MORE_STEPS, settings.test_samples * TEST_EVERY)) // len(settings.targets)
    recordings: list[Job] = []
    gpu_gb = policy_gb(settings.task.image_size_px, FRAMES, LEARNT_BATCH)
    disturbance = DisturbanceSettings(noise=settings.noise, spell_chance=settings.spell_chance)
    for target in settings.targets:
        task = LearningTask(settings.phantom, target, settings.task)
        expert = expert_folder(context.inputs["enn"], task.name, settings.expert)
        require_expert(settings.name, task, expert)
        key = f"{task.name}/episodes"
        recording = RecordingJob(context.path / key, disturbance, task, expert, steps + 1, context.seed)
        recordings.append(Job(key, record_disturbed, recording, gpu_gb=gpu_gb))
    logs, after = tuple(job.given.folder for job in recordings), tuple(job.key for job in recordings)
    preset = force_preset(settings.variant)
    preset = replace(preset, fit=replace(preset.fit, epochs=settings.epochs or preset.fit.epochs))
    fits = []
    input_counts = [(THESIS_INPUTS, count) for count in settings.samples]
    input_counts += [(inputs, settings.samples[-1]) for inputs in settings.inputs if inputs != THESIS_INPUTS]
    for inputs, count in input_counts:
        key = f"{inputs}/{count}"
        fit = ForceJob(
            folder=context.path / key,
            settings=preset,
            logs=logs,
            expert=recordings[0].given.expert,
            inputs=inputs,
            samples=count,
            test_samples=settings.test_samples,
            seed=context.seed,
        )
        fits.append(Job(key, learn_force, fit, after=after, gpu_gb=gpu_gb))
    shapes = []
    for row, disturbed in SHAPE_ROWS.items():
        shape = ShapeForceJob(
            phantom=settings.phantom,
            logs=logs,
            test_samples=settings.test_samples,
            seed=context.seed,
            disturbed=disturbed,
        )
        shapes.append(Job(row, forces_from_shape, shape, after=after))
    return recordings, fits, shapes


def row_of(samples: int) -> str:
    """The thesis's name of a number of samples: 1000 is ``fpn_1k``."""
    return f"fpn_{samples // 1000}k" if samples % 1000 == 0 else f"fpn_{samples}"


def tables(fits: Sequence[Job], outcomes: dict[str, Any], shapes: Sequence[Job]) -> dict[str, Any]:
    """The thesis's table, the errors as a share of the variance, and the distribution of the forces."""
    last = outcomes[fits[-1].key]
    mse: dict[str, Any] = {
        "baseline": {"mse_n2": last["mean_mse_n2"]},
        "untrained": {"mse_n2": last["untrained_mse_n2"]},
    }
    share: dict[str, Any] = {
        "baseline": {
            "mse_n2": last["mean_mse_n2"],
            "variance_n2": last["variance_n2"],
            "share_pct": 100.0 * last["mean_mse_n2"] / last["variance_n2"] if last["variance_n2"] > 0 else None,
        }
    }
    for job in fits:
        outcome = outcomes[job.key]
        thesis = job.given.inputs == THESIS_INPUTS
        row = row_of(job.given.samples) + ("" if thesis else f" {job.given.inputs}")
        if thesis:
            mse[row] = {"mse_n2": outcome["mse_n2"], "n": outcome["test_samples"]}
        share[row] = {**{key: outcome[key] for key in _SHARE}, "n": outcome["test_samples"]}
    for job in shapes:
        outcome = outcomes[job.key]
        mse[job.key] = {"mse_n2": outcome["mse_n2"], "n": outcome["test_samples"]}
        share[job.key] = {**{key: outcome[key] for key in _SHARE}, "n": outcome["test_samples"]}
    forces = {
        "test": {key: last[key] for key in ("force_mean_n", "variance_n2", "force_p95_n", "force_max_n")}
        | {"n": last["test_samples"]}
    }
    return {"force_prediction_mse": mse, "force_share": share, "force_distribution": forces}


def figures(fits: Sequence[Job], outcomes: dict[str, Any], folder: Path) -> list[Figure]:
    """Draws the calibration into the stage's folder."""
    draw_calibration({job.key: outcomes[job.key]["calibration"] for job in fits}, folder / "calibration.png")
    last = outcomes[fits[-1].key]
    spread = (
        f"mean {last['force_mean_n']:.3f} N, variance {last['variance_n2']:.2g} N², largest {last['force_max_n']:.2f} N"
    )
    caption = f"Bins of equally many test samples by predicted force; episodes that were not learnt from; {spread}."
    return [Figure("Predicted and true contact force", caption, "calibration.png", GROUP)]


STAGE = Stage(settings=ForceSettings, run=run_force, reads=("enn",), check=check_force, repeated=True)
