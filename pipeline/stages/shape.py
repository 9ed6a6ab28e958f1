"""The shape stage: the wire in space, predicted from frames of one camera, on unseen acquisitions."""

from __future__ import annotations

from typing import Any

from guide3d.reconstruction.evaluation import METRICS
from pipeline.jobs.pool import Job
from pipeline.plots.networks import draw_along, draw_in_space, draw_reprojections
from pipeline.stages import Stage, StageContext
from pipeline.stages.networks.settings import ShapeSettings
from pipeline.stages.networks.training import (
    PRELOAD,
    cost_cells,
    learn,
    shipped_rows,
    train_and_compare,
    training_job,
)
from pipeline.tables import Figure, Results

GROUP = "Shape prediction"
THESIS_ROWS = ("cartesian", "spherical")
LABELS = {
    "spherical": "spherical",
    "cartesian": "Cartesian",
    "spherical_angles": "spherical, loss on angles alone",
    "fgrn": "3D-FGRN",
}


def run_shape(settings: ShapeSettings, context: StageContext) -> Results:
    jobs, labels = plan(settings, context), {row: LABELS[row].capitalize() for row in settings.rows}
    return train_and_compare(
        settings, context, jobs, tables, figures, label="shape networks", preload=PRELOAD, labels=labels
    )


def plan(settings: ShapeSettings, context: StageContext) -> list[Job]:
    taken = shipped_rows(settings, context)
    return [training_job(row, learn, settings, context, taken.get(row)) for row in settings.rows]


def tables(settings: ShapeSettings, outcomes: dict[str, Any]) -> dict[str, Any]:
    """The thesis's table, and one with every network and every distance; table to row to column to cell."""
    thesis = {
        row: {name: outcomes[row][name] for name in METRICS if name != "chamfer"} | {"n": outcomes[row]["frames"]}
        for row in THESIS_ROWS
        if row in settings.rows
    }
    own = {}
    for row in settings.rows:
        outcome = outcomes[row]
        own[row] = {name: outcome[name] for name in (*METRICS, "length_error_mm", "reprojection_px")}
        own[row] |= {**cost_cells(outcome), "ms_a_frame": outcome["ms_a_frame"], "n": outcome["frames"]}
    return {"shape_prediction_mm": thesis, "shape_networks": own}


def figures(settings: ShapeSettings, outcomes: dict[str, Any], context: StageContext) -> list[Figure]:
    """Draws curves in space, their projections, the error along the wire."""
    folder = context.path
    named = {LABELS[row]: outcomes[row] for row in settings.rows}
    outcome = outcomes[settings.rows[0]]
    unseen = f"{outcome['frames']} frames of {outcome['acquisitions']} acquisitions that no network has seen"
    drawn = []
    for row in settings.rows:
        if row not in THESIS_ROWS:
            continue
        draw_in_space(folder / row, folder / f"{row}_space.png")
        draw_reprojections(folder / row, context.inputs["guide3d"], folder / f"{row}_reprojection.png")
        drawn += [
            Figure(
                f"Predicted wires in space, {LABELS[row]}",
                f"From two angles: a frame whose MaxED is at the 10th, the 50th and the 90th percentile; {unseen}.",
                f"{row}_space.png",
                GROUP,
            ),
            Figure(
                f"The same wires projected into camera A, {LABELS[row]}",
                "Annotated (blue) and predicted (orange) line over the image that was seen.",
                f"{row}_reprojection.png",
                GROUP,
            ),
        ]
    draw_along(named, folder / "error_along.png")
    return [
        *drawn,
        Figure(
            "Error along the wire",
            f"Mean distance at equal arc length from the tip; {unseen}. Lengths that fewer than five wires have are "
            "left out; 3D-FGRN, which has no stop, is cut at the true length.",
            "error_along.png",
            GROUP,
        ),
    ]


STAGE = Stage(settings=ShapeSettings, run=run_shape, reads=("guide3d",), repeated=True)
