"""The splineformer stage: wires read off images as B-splines, two variants, beside a segmentation that is traced."""

from __future__ import annotations

from typing import Any

from pipeline.jobs.pool import Job
from pipeline.plots.shape import draw_training
from pipeline.plots.splineformer import draw_attention, draw_comparison, draw_errors
from pipeline.stages import Stage, StageContext
from pipeline.stages.networks.settings import SplineformerSettings
from pipeline.stages.networks.splineformer import EXAMPLES, PRELOAD, ComparisonJob, compare, learn_variant
from pipeline.stages.networks.stage import train_and_compare, training_job
from pipeline.tables import Figure, Results

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
    "round_trip_px", "tokens_mean", "tokens_max", "recognised_one_pct", "recognised_none_pct",
    "recognised_several_pct", "recognised_inverted_pct", "image_px", "epochs", "cpu_min", "latency_ms", "images_per_s",
)  # fmt: skip


def run_splineformer(settings: SplineformerSettings, context: StageContext) -> Results:
    """Trains the variants and compares them with the segmentation."""
    jobs = plan(settings, context)
    return train_and_compare(settings, context, jobs, tables, figures, label="splineformers", preload=PRELOAD)


def plan(settings: SplineformerSettings, context: StageContext) -> list[Job]:
    """A training a variant, then the comparison."""
    jobs = [training_job(variant, learn_variant, settings, context, weight=4.0) for variant in settings.variants]
    given = ComparisonJob(
        folder=context.path / COMPARISON,
        guide3d=context.inputs["guide3d"],
        variants={variant: context.path / variant for variant in settings.variants},
        rival=context.inputs["segmentation"] / settings.rival,
        settings=settings,
        seed=context.seed,
    )
    gpu_gb = max(job.gpu_gb for job in jobs)  # it reads with all of them, and learns nothing
    return [*jobs, Job(COMPARISON, compare, given, after=tuple(settings.variants), gpu_gb=gpu_gb)]


def tables(settings: SplineformerSettings, outcomes: dict[str, Any]) -> dict[str, Any]:
    """The comparison, by disturbance and reader, and each variant alone; table to row to column to cell."""
    compared: dict[str, Any] = {}
    for kind, readers in outcomes[COMPARISON].items():
        for reader, read in readers.items():
            single = {name: read[name] for name in ("median_px", "median_tip_px", "discontinuities", "read_pct")}
            errors = {name: read[name] for name in _ERRORS if name in read}
            compared[f"{kind}/{reader}"] = {**errors, **single, "ms_an_image": read["ms_an_image"], "n": read["n"]}
    alone = {}
    for variant in settings.variants:
        outcome, plain = outcomes[variant], outcomes[COMPARISON]["none"][variant]
        alone[variant] = {
            **{name: plain[name] for name in ("tip_px", "mean_px", "max_px") if name in plain},
            **{name: outcome[name] for name in _ALONE},
            "parameters_m": outcome["parameters"] / 1e6,
            "n": plain["n"],
        }
    return {"splineformer_segmentation": compared, "splineformer_variants": alone}


def figures(settings: SplineformerSettings, outcomes: dict[str, Any], context: StageContext) -> list[Figure]:
    """Draws examples, errors, attention and trainings."""
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
    repeated=True,
)
