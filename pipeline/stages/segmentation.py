"""The segmentation stage: UNet, TransUnet and SwinUnet find the wire's pixels, evaluated on unseen acquisitions."""

from __future__ import annotations

from typing import Any

from pipeline.jobs.pool import Job
from pipeline.plots.networks import draw_examples, draw_kinds
from pipeline.stages import Stage, StageContext
from pipeline.stages.networks.settings import SegmentationSettings
from pipeline.stages.networks.training import PRELOAD, cost_cells, learn, train_and_compare, training_job
from pipeline.tables import Figure, Results

GROUP = "Segmentation"
LABELS = {"unet": "UNet", "transunet": "TransUnet", "swinunet": "SwinUnet"}


def run_segmentation(settings: SegmentationSettings, context: StageContext) -> Results:
    jobs = plan(settings, context)
    return train_and_compare(
        settings, context, jobs, tables, figures, label="segmenters", preload=PRELOAD, labels=LABELS
    )


def plan(settings: SegmentationSettings, context: StageContext) -> list[Job]:
    return [training_job(row, learn, settings, context) for row in settings.rows]


def tables(settings: SegmentationSettings, outcomes: dict[str, Any]) -> dict[str, Any]:
    """The thesis's table, and one with every metric, at both resolutions; table to row to column to cell."""
    thesis, own = {}, {}
    for row in settings.rows:
        outcome = outcomes[row]
        thesis[row] = {name: outcome[name] for name in ("dice", "miou", "jaccard")} | {"n": outcome["images"]}
        own[row] = {
            **{name: outcome[name] for name in ("dice", "iou_foreground", "miou", "centreline_dice", "dice_small")},
            "size_px": outcome["size_px"],
            **cost_cells(outcome),
            "ms_an_image": outcome["ms_an_image"],
            "n": outcome["images"],
        }
    return {"segmentation": thesis, "segmentation_networks": own}


def figures(settings: SegmentationSettings, outcomes: dict[str, Any], context: StageContext) -> list[Figure]:
    folder = context.path
    named = {LABELS[row]: outcomes[row] for row in settings.rows}
    outcome = outcomes[settings.rows[0]]
    unseen = f"{outcome['images']} images of {outcome['acquisitions']} acquisitions that no network has seen"
    draw_examples({LABELS[row]: folder / row for row in settings.rows}, folder / "examples.png")
    draw_kinds(named, folder / "kinds.png")
    return [
        Figure(
            "Segmentation examples",
            f"An image whose Dice is at the 5th, the 50th and the 95th percentile of each network; {unseen}. A wire is "
            f"{outcome['mask_px']:g} px wide in images of {outcome['source_px']} px.",
            "examples.png",
            GROUP,
        ),
        Figure("Dice by wire and fluid", f"Mean and standard deviation; {unseen}.", "kinds.png", GROUP),
    ]


STAGE = Stage(settings=SegmentationSettings, run=run_segmentation, reads=("guide3d",))
