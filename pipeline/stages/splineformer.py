"""The splineformer stage: wires read off images as B-splines, two variants, beside a segmentation that is traced."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.pool import Job
from pipeline.jobs.worker import OPTIMISER, Report
from pipeline.plots.networks import draw_attention, draw_comparison
from pipeline.stages import Stage, StageContext
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.networks.settings import SplineformerSettings
from pipeline.stages.networks.training import (
    PREDICTOR,
    TrainingJob,
    shipped_rows,
    train,
    train_and_compare,
    training_figures,
    training_job,
)
from pipeline.store.atomic_files import atomic_path, read_json, write_json
from pipeline.store.errors import StageError
from pipeline.tables import Figure, Results

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset
    from splineformer.comparison.evaluation import Reader


PRELOAD = (
    "splineformer.learning.training",
    "splineformer.comparison.fluoroscopy_figures",
    "guide3d.learning.predictor",
    OPTIMISER,
)
RECORD, EXAMPLES = "variant.json", "examples.npz"
_KINDS_OF = 48  # test images whose kind is asked for, in each of the four forms
_TRIPS = 400  # curves that go to tokens and back


def learn_variant(job: TrainingJob, report: Report) -> dict[str, Any]:
    """Trains a variant and measures its size, cost, speed, losses, round trips of tokens, and kinds it recognises."""
    file = job.folder / RECORD
    if file.is_file():
        return dict(read_json(file))
    training = train(
        "splineformer.learning.training", job, ["--variant", job.network], ("images", "calibration"), report
    )
    from guide3d.dataset.dataset import images_of, split
    from splineformer.comparison.fluoroscopy_figures import kind_accuracy, round_trips, speed
    from splineformer.predictor import Predictor

    data = open_dataset(job.guide3d)
    predictor = Predictor.load(job.folder / PREDICTOR, device=report.device)
    report(0.92, "speed")
    draws = np.random.default_rng(job.seed).permutation(len(data.frames))[:_TRIPS].tolist()
    curves = [data.frames[index].polyline("ab"[number % 2]) for number, index in enumerate(draws)]
    trips = round_trips(predictor.network.fit_tokens, curves)
    items = images_of(data, split(data, seed=job.settings.split_seed).test, _KINDS_OF).tolist()

    def progress(number: int, of: int) -> None:
        report(0.94 + 0.05 * number / of, "kinds of image")

    outcome = {
        "variant": job.network,
        "image_px": predictor.network.settings.image_px,
        **training_figures(training, predictor),
        **speed(Predictor.load(job.folder / PREDICTOR), data.frames[0].image("a")),
        **{name: trips[name] for name in ("round_trip_px", "tokens_mean", "tokens_max")},
        **{
            f"recognised_{k}_pct": share
            for k, share in kind_accuracy(predictor, data, items, job.seed, progress).items()
        },
    }
    write_json(file, outcome)
    return outcome


@dataclass(frozen=True)
class ComparisonJob:
    """Readers to compare."""

    folder: Path  # gets a record a disturbance, and examples
    guide3d: Path
    variants: dict[str, Path]
    rival: Path  # folder of the segmentation network
    settings: SplineformerSettings
    seed: int


def compare(job: ComparisonJob, report: Report) -> dict[str, Any]:
    """Lets every reader read the test images; returns disturbance to reader to its figures: see `evaluate_readers`."""
    from guide3d.dataset.dataset import images_of, split
    from splineformer.comparison.evaluation import evaluate_readers, example_arrays, examples_of
    from splineformer.predictor import Predictor

    settings, data = job.settings, open_dataset(job.guide3d)
    readers = readers_of(job, data, report.device)
    test = split(data, seed=settings.split_seed).test
    plain, disturbed = (images_of(data, test, n).tolist() for n in (settings.test_images, settings.disturbed_images))
    outcome: dict[str, Any] = {}
    for place, kind in enumerate(settings.disturbances):
        file = job.folder / f"{kind}.json"
        if not file.is_file():

            def progress(number: int, of: int, place: int = place, kind: str = kind) -> None:
                report((place + number / of) / len(settings.disturbances), f"{kind}: image {number + 1} of {of}")

            items = plain if kind == "none" else disturbed
            write_json(file, evaluate_readers(readers, data, items, kind, job.seed, progress))
        outcome[kind] = read_json(file)
    if not (job.folder / EXAMPLES).is_file():
        chosen = examples_of(outcome["none"][settings.rival], plain, disturbed, settings.disturbances)
        networks = {name: Predictor.load(folder / PREDICTOR) for name, folder in job.variants.items()}
        with atomic_path(job.folder / EXAMPLES) as temporary:
            np.savez_compressed(temporary, **example_arrays(chosen, data, readers, networks, job.seed))
    return outcome


def readers_of(job: ComparisonJob, data: Dataset, device: str) -> dict[str, Reader]:
    """The rival and the variants, from their files."""
    from guide3d.dataset.dataset import split
    from guide3d.learning.predictor import SegmentationPredictor
    from splineformer.comparison.evaluation import curve_reader, mask_reader
    from splineformer.predictor import Predictor

    file, rival = job.rival / PREDICTOR, job.settings.rival
    if not file.is_file():
        raise StageError(f"{file} is missing: let the stage segmentation train {rival}, or choose another rival")
    training = split(data, seed=job.settings.split_seed).train
    readers = {rival: mask_reader(SegmentationPredictor.load(file, device), data, training)}
    for name, folder in job.variants.items():
        readers[name] = curve_reader(Predictor.load(folder / PREDICTOR, device=device))
    return readers


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
    return train_and_compare(
        settings, context, jobs, tables, figures, label="splineformers", preload=PRELOAD, labels=LABELS
    )


def plan(settings: SplineformerSettings, context: StageContext) -> list[Job]:
    """A training a variant, then the comparison."""
    taken = shipped_rows(settings, context)
    jobs = [
        training_job(variant, learn_variant, settings, context, taken.get(variant)) for variant in settings.variants
    ]
    comparison_job = ComparisonJob(
        folder=context.path / COMPARISON,
        guide3d=context.inputs["guide3d"],
        variants={variant: context.path / variant for variant in settings.variants},
        rival=context.inputs["segmentation"] / settings.rival,
        settings=settings,
        seed=context.seed,
    )
    gpu_gb = max(job.gpu_gb for job in jobs)  # it reads with all of them, and learns nothing
    return [*jobs, Job(COMPARISON, compare, comparison_job, after=tuple(settings.variants), gpu_gb=gpu_gb)]


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
    folder, variants = context.path, settings.variants
    examples = folder / COMPARISON / EXAMPLES
    draw_comparison(examples, settings.rival, variants, LABELS, folder / "comparison.png")
    draw_attention(examples, variants, LABELS, folder / "attention.png")
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
            "Attention of SplineFormer",
            "Cross-attention of the last decoder layer, heads fused by their maximum, values below 0.65 of the "
            "greatest discarded; the line is the curve that was read.",
            "attention.png",
            GROUP,
        ),
    ]


STAGE = Stage(
    settings=SplineformerSettings, run=run_splineformer, version=2, reads=("guide3d", "segmentation"), repeated=True
)
