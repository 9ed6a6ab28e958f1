"""Readings as files: the curve as a table (CSV), for 3D Slicer and VTK, all of it as JSON; a sequence a row a frame."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from guide3d.files import whole_file
from guide3d.geometry.polyline import arc_length
from guide3d.reading.image_reading import ImageReading
from guide3d.reading.pair_reading import PairReading

VERSION = 1
FRAME_COLUMNS = (
    "frame", "found", "tip_x", "tip_y", "tip_z", "length", "tip_sd", "confidence", "residual_px", "accepted", "messages"
)  # fmt: skip


def curve_table(reading: ImageReading | PairReading) -> str:
    """The curve as CSV, tip first: px with confidence and deviation, or mm with deviation."""
    if isinstance(reading, PairReading):
        columns = ["s_mm", "x_mm", "y_mm", "z_mm", "sd_mm"]
        values = [arc_length(reading.curve_mm), *reading.curve_mm.T, reading.sd_mm]
    else:
        columns = ["s_px", "x_px", "y_px", "confidence", "sd_px"]
        values = [arc_length(reading.points_px), *reading.points_px.T, reading.confidence, reading.sd_px]
    return _csv(columns, ([f"{value:.4f}" for value in row] for row in np.stack(values, axis=1)))


def curve_markups(reading: PairReading) -> dict[str, Any]:
    """The curve in space as a markups file of 3D Slicer (`.mrk.json`, schema 1.0.3): an open curve, LPS, mm, tip first.

    The axes are those of the cameras' world, taken as LPS.
    """
    points = [
        {"id": str(number), "label": "tip" if number == 1 else "", "position": _rounded(point, 4)}
        for number, point in enumerate(reading.curve_mm, start=1)
    ]
    curve = {"type": "Curve", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": points}
    schema = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    return {"@schema": f"{schema}markups-schema-v1.0.3.json#", "markups": [curve]}


def curve_polydata(reading: PairReading) -> str:
    """The curve in space as a poly-line of VTK's XML format (`.vtp`), mm, tip first, with its standard deviation."""
    count = len(reading.curve_mm)
    numbers = " ".join(f"{value:.4f}" for value in reading.curve_mm.ravel())
    deviations = " ".join(f"{value:.4f}" for value in reading.sd_mm)
    order = " ".join(map(str, range(count)))
    return (
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian"><PolyData>'
        f'<Piece NumberOfPoints="{count}" NumberOfLines="1">'
        f'<PointData><DataArray type="Float64" Name="sd_mm" format="ascii">{deviations}</DataArray></PointData>'
        f'<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">{numbers}</DataArray></Points>'
        f'<Lines><DataArray type="Int64" Name="connectivity" format="ascii">{order}</DataArray>'
        f'<DataArray type="Int64" Name="offsets" format="ascii">{count}</DataArray></Lines>'
        "</Piece></PolyData></VTKFile>\n"
    )


def image_record(reading: ImageReading) -> dict[str, Any]:
    """A reading of one image as plain JSON values; px of the image, tip first."""
    return {
        "version": VERSION,
        "found": reading.found,
        "points_px": _rounded(reading.points_px, 3),
        "confidence": _rounded(reading.confidence, 3),
        "sd_px": _rounded(reading.sd_px, 3),
        "tip_px": None if reading.tip_px is None else _rounded(reading.tip_px, 3),
        "tip_confidence": round(float(reading.tip_confidence), 3),
        "overall_confidence": round(reading.overall_confidence, 3),
        "candidates": [
            {"score": round(float(curve.score), 1), "points_px": _rounded(curve.points_px[::4], 2)}
            for curve in reading.candidates
        ],
        "others_px": [_rounded(curve.points_px, 3) for curve in reading.others],
        "messages": list(reading.messages),
    }


def pair_record(reading: PairReading) -> dict[str, Any]:
    """A reading of two images as plain JSON values; world mm, tip first."""
    return {
        "version": VERSION,
        "accepted": bool(reading.accepted),
        "curve_mm": _rounded(reading.curve_mm, 4),
        "covariance_mm2": _rounded(reading.covariance_mm2, 6),
        "sd_mm": _rounded(reading.sd_mm, 4),
        "tip_mm": _rounded(reading.curve_mm[0], 4),
        "length_mm": round(reading.reconstruction.length_mm, 3),
        "epipolar_residual_px": round(float(reading.residual_px), 3),
        "reprojection_px": [
            round(float(value), 3) for value in (reading.reconstruction.mean_a_px, reading.reconstruction.mean_b_px)
        ],
        "coverage": round(float(reading.reconstruction.coverage), 4),
        "views": {name: image_record(view) for name, view in zip("ab", reading.views, strict=True)},
        "messages": list(reading.messages),
    }


def frame_row(number: int, reading: ImageReading | PairReading | None, said: str = "") -> list[str]:
    """A row of the table of a sequence (`FRAME_COLUMNS`); mm of a wire in space, px of one image.

    Args:
        number: of the frame, counted from 0.
        reading: None where the frame could not be read.
        said: why.
    """
    if reading is None or (isinstance(reading, ImageReading) and not reading.found):
        messages = said or ("" if reading is None else "; ".join(reading.messages))
        return [str(number), "0", *[""] * (len(FRAME_COLUMNS) - 3), messages]
    if isinstance(reading, PairReading):
        confidence = float(np.mean([view.overall_confidence for view in reading.views]))
        numbers = [*reading.curve_mm[0], reading.reconstruction.length_mm, reading.sd_mm[0], confidence]
        tail = [f"{reading.residual_px:.3f}", str(int(reading.accepted))]
        cells = [f"{value:.3f}" for value in numbers]
    else:
        length = float(arc_length(reading.points_px)[-1])
        x, y = reading.points_px[0]
        cells = [f"{x:.3f}", f"{y:.3f}", ""]
        cells += [f"{value:.3f}" for value in (length, reading.sd_px[0], reading.overall_confidence)]
        tail = ["", ""]
    return [str(number), "1", *cells, *tail, "; ".join(reading.messages)]


def frame_table(rows: Iterable[Sequence[str]]) -> str:
    """Rows of `frame_row` as CSV."""
    return _csv(FRAME_COLUMNS, rows)


def write_text(text: str, path: Path) -> None:
    """Writes a text file that appears whole or not at all."""
    with whole_file(path, "w") as file:
        file.write(text)


def write_record(record: Any, path: Path) -> None:
    """Writes plain values as JSON; the file appears whole or not at all."""
    write_text(json.dumps(record, allow_nan=False) + "\n", path)


def _csv(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def _rounded(values: np.ndarray, digits: int) -> Any:
    return np.round(np.asarray(values, float), digits).tolist()
