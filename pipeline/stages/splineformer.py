"""The splineformer stage: wires read off images as B-splines, two variants, beside a segmentation that is traced."""

from __future__ import annotations

from typing import Any

from pipeline.jobs.pool import Job, run_jobs
from pipeline.report.plots.shape import draw_training
from pipeline.report.plots.splineformer import draw_attention, draw_comparison, draw_errors
from pipeline.report.results import Figure, write_figures, write_results
from pipeline.stages import Stage, StageContext
from pipeline.stages.networks.comparison import EXAMPLES, ComparisonJob, compare
from pipeline.stages.networks.splineformer import PRELOAD, VariantJob, learn_variant
from pipeline.stages.networks.splineformer_settings import SplineformerSettings
from pipeline.stages.networks.stage import on_gpus, training_job

GROUP = "SplineFormer"
COMPARISON = "comparison"
LABELS = {
    "published": "SplineFormer, as published",
    "ordered": "SplineFormer, ordered queries",
    "unet": "UNet + skeleton",
    "transunet": "TransUnet + skeleton",
    "swinunet": "SwinUnet + skeleton",
}
_ERRORS = ("tip_px", "mean_px", "max_px", "tip_mm", "mean_mm", "max_mm", "chamfer_px", "dice_pct")
_ALONE = (
    "round_trip_px", "tokens_mean", "tokens_max", "told_one_pct", "told_none_pct", "told_several_pct",
    "told_inverted_pct", "image_px", "epochs", "cpu_min", "latency_ms", "images_per_s",
)  # fmt: skip


def run_splineformer(settings: SplineformerSettings, context: StageContext) -> None:
    """Trains the variants and compares them with the segmentation.

    Args:
        settings: of the stage.
        context: where data set and segmentation lie, and where to write.
    """
    jobs = plan(settings, context)
    outcomes = run_jobs(
        context.folder, jobs, workers=settings.workers, label="splineformers", preload=PRELOAD, device=settings.device
    )
    write_results(context.path, tables(settings, outcomes))
    write_figures(context.path, figures(settings, outcomes, context))


def plan(settings: SplineformerSettings, context: StageContext) -> list[Job]:
    """A training a variant, then the comparison.

    Args:
        settings: of the stage.
        context: likewise.
    """
    guide3d = context.inputs["guide3d"]
    jobs = [
        Job(
            variant,
            learn_variant,
            training_job(VariantJob, variant, settings, context, tensorboard=settings.tensorboard),
            weight=4.0,
            **on_gpus(variant, settings),
        )
        for variant in settings.variants
    ]
    given = ComparisonJob(
        folder=context.path / COMPARISON,
        guide3d=guide3d,
        variants={variant: context.path / variant for variant in settings.variants},
        rival=settings.rival,
        rival_folder=context.inputs["segmentation"] / settings.rival,
        disturbances=tuple(settings.disturbances),
        test_images=settings.test_images,
        disturbed_images=settings.disturbed_images,
        split_seed=settings.split_seed,
        seed=context.seed,
    )
    gpu_gb = max(job.gpu_gb for job in jobs)  # it reads with all of them, and learns nothing
    return [*jobs, Job(COMPARISON, compare, given, after=tuple(settings.variants), gpu_gb=gpu_gb)]


def tables(settings: SplineformerSettings, outcomes: dict[str, Any]) -> dict[str, Any]:
    """The comparison, by disturbance and reader, and what each variant is like alone.

    Args:
        settings: of the stage.
        outcomes: of the jobs.

    Returns:
        Table to row to column to cell.
    """
    compared: dict[str, Any] = {}
    for kind, readers in outcomes[COMPARISON].items():
        for reader, told in readers.items():
            single = {name: told[name] for name in ("median_px", "median_tip_px", "discontinuities", "read_pct")}
            errors = {name: told[name] for name in _ERRORS if name in told}
            compared[f"{kind}/{reader}"] = {**errors, **single, "ms_an_image": told["ms_an_image"], "n": told["n"]}
    alone = {}
    for variant in settings.variants:
        told, plain = outcomes[variant], outcomes[COMPARISON]["none"][variant]
        alone[variant] = {
            **{name: plain[name] for name in ("tip_px", "mean_px", "max_px") if name in plain},
            **{name: told[name] for name in _ALONE},
            "parameters_m": told["parameters"] / 1e6,
            "n": plain["n"],
        }
    return {"splineformer_segmentation": compared, "splineformer_variants": alone}


def figures(settings: SplineformerSettings, outcomes: dict[str, Any], context: StageContext) -> list[Figure]:
    """Draws examples, errors, attention and trainings.

    Args:
        settings: of the stage.
        outcomes: of the jobs.
        context: of the stage.
    """
    folder, variants = context.path, settings.variants
    examples = folder / COMPARISON / EXAMPLES
    draw_comparison(examples, settings.rival, variants, LABELS, folder / "comparison.png")
    draw_errors(outcomes[COMPARISON], LABELS, folder / "errors.png")
    draw_attention(examples, variants, LABELS, folder / "attention.png")
    draw_training({LABELS[variant]: outcomes[variant] for variant in variants}, folder / "training.png", "loss")
    count = outcomes[COMPARISON]["none"][settings.rival]["n"]
    return [
        Figure(
            "SplineFormer and segmentation",
            f"Above: mask of the {LABELS[settings.rival].split()[0]} and the curve traced from its skeleton; below: "
            "the B-splines with their control points. From the left: the rival's median error, its 95th percentile, "
            "and a partly hidden wire. Acquisitions that no network has seen.",
            "comparison.png",
            GROUP,
        ),
        Figure(
            "Errors of SplineFormer and of the traced segmentation",
            f"{count} images of unseen acquisitions; at the right the medians under disturbances.",
            "errors.png",
            GROUP,
        ),
        Figure(
            "Attention of SplineFormer",
            "Cross-attention of the last decoder layer, heads fused by their maximum, values below 0.65 of the "
            "greatest discarded; the line is the curve that was read.",
            "attention.png",
            GROUP,
        ),
        Figure("Training of SplineFormer", "Loss by epoch; the variants' losses differ.", "training.png", GROUP),
    ]


STAGE = Stage(
    settings=SplineformerSettings,
    run=run_splineformer,
    reads=("guide3d", "segmentation"),
    writes=(
        "<variant>/{predictor.pt, training.json, variant.json}",
        "comparison/{<disturbance>.json, examples.npz}",
        "comparison.png, errors.png, attention.png, training.png",
        "results.json",
        "figures.json",
    ),
    place=13,
)
