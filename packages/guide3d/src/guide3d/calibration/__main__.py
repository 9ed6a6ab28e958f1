"""Command line of calibration: python -m guide3d.calibration DIR --output FOLDER.

Writes FOLDER/index.html with its pictures, the cameras (XMALab text, OpenCV YAML) and the distortion maps.
"""

from __future__ import annotations

import argparse
import html
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from guide3d.calibration.cube_calibration import CubeCalibration, calibrate_folder
from guide3d.calibration.cube_files import find_files, read_grey
from guide3d.calibration.pictures import RESIDUAL_SCALE, draw_beads, draw_displacement, draw_holes
from guide3d.commands import in_words, run
from guide3d.files import whole_file
from guide3d.geometry.distortion import leave_out_errors
from guide3d.image_file import write_png

_STYLE = """body{font:16px/1.5 Georgia,serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.25rem .9rem;border-bottom:1px solid #ccc;text-align:right}
td:first-child,th:first-child{text-align:left}img{max-width:100%;border:1px solid #ccc}figcaption{color:#555}
figure{margin:1.5rem 0}.warning{background:#fff3cd;padding:.6rem 1rem}"""


def figures(calibration: CubeCalibration) -> dict:
    """The figures of a calibration.

    Returns:
        By detector: holes, leave_out_px (mean), leave_out_rms_px, swirl_px, and images: by pose: beads (labelled),
        used, unseen, mean_px, rms_px and max_px over all labelled beads, alone_mean_px (a camera of that image alone,
        over the beads used).
    """
    rig, result = calibration.rig, {}
    for detector, holes in calibration.holes.items():
        errors = leave_out_errors(holes)
        images = {}
        for (pose, other), view in calibration.views.items():
            if other != detector or (pose, other) not in rig.used:
                continue
            off = np.linalg.norm(rig.residuals_px[pose, other], axis=1)
            alone = np.linalg.norm(rig.alone_px[pose, other][rig.used[pose, other]], axis=1)
            images[pose] = {
                "beads": len(off),
                "used": int(rig.used[pose, other].sum()),
                "unseen": len(view.unseen),
                "mean_px": float(off.mean()),
                "rms_px": float(np.sqrt((off**2).mean())),
                "max_px": float(off.max()),
                "alone_mean_px": float(alone.mean()),
            }
        result[detector] = {
            "holes": len(holes),
            "leave_out_px": float(errors.mean()),
            "leave_out_rms_px": float(np.sqrt((errors**2).mean())),
            "swirl_px": rig.swirl_px.get(detector, 0.0),
            "images": images,
        }
    return result


def write_report(calibration: CubeCalibration, source: str | Path, folder: str | Path) -> Path:
    """Write the page, its pictures, the cameras and the maps into a folder, made if missing."""
    folder = Path(folder)
    files, numbers = find_files(source), figures(calibration)
    calibration.write(folder)
    parts = ["<h1>Calibration</h1>", f"<p>From the images in {html.escape(Path(source).name)}.</p>"]
    parts += [f'<p class="warning">{html.escape(warning)}.</p>' for warning in calibration.warnings]
    parts += ["<h2>Figures</h2>", _distortion_table(numbers), _cube_table(numbers)]
    parts += ["<h2>Cameras</h2>", _camera_table(calibration)]
    for detector, holes in calibration.holes.items():
        parts.append(f"<h2>Detector {html.escape(detector)}</h2>")
        distortion = calibration.distortions[detector]
        pictures = {
            f"holes_{detector}.png": (
                draw_holes(read_grey(files.sheets[detector]), holes),
                "Holes of the sheet; red ones are cut by the border.",
            ),
            f"displacement_{detector}.png": (draw_displacement(holes, distortion), "Displacement of the lattice."),
        }
        for (pose, other), view in calibration.views.items():
            if other == detector:
                caption = (
                    f"Beads of {pose}, counted from 1; residuals {RESIDUAL_SCALE} times enlarged; red: left out or "
                    "clutter; blue: wire marks, and beads that should be seen and could not be measured."
                )
                pictures[f"beads_{pose}_{detector}.png"] = (draw_beads(calibration, view), caption)
        for name, (picture, caption) in pictures.items():
            write_png(picture, folder / name)
            image_tag = f'<img src="{html.escape(name)}" alt="{html.escape(caption)}">'
            parts.append(f"<figure>{image_tag}<figcaption>{html.escape(caption)}</figcaption></figure>")
    page = folder / "index.html"
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Calibration</title><style>{_STYLE}</style>'
    with whole_file(page, "w") as file:
        file.write(head + "\n".join(parts) + "</html>\n")
    return page


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["<tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in header) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    return "<table>" + "".join(lines) + "</table>"


def _distortion_table(numbers: dict) -> str:
    rows = [
        [d, str(n["holes"]), f"{n['leave_out_px']:.3f}", f"{n['leave_out_rms_px']:.3f}", f"{n['swirl_px']:.2f}"]
        for d, n in numbers.items()
    ]
    return _table(["detector", "holes", "leave-out mean, px", "RMS, px", "swirl, px"], rows)


def _cube_table(numbers: dict) -> str:
    digits = {"beads": "d", "used": "d", "mean_px": ".3f", "rms_px": ".3f", "max_px": ".2f", "alone_mean_px": ".3f"}
    rows = [
        [pose, detector, *(format(image[key], form) for key, form in digits.items())]
        for detector, own in numbers.items()
        for pose, image in own["images"].items()
    ]
    header = ("pose", "detector", "beads labelled", "used", "mean, px", "RMS, px", "largest, px")
    return _table([*header, "camera of this image alone, px"], rows)


def _camera_table(calibration: CubeCalibration) -> str:
    rows = []
    for detector, camera in calibration.rig.cameras.items():
        sd = np.sqrt(np.diag(camera.covariance)) if camera.covariance is not None else np.full(11, np.nan)
        K = camera.K
        values = (K[0, 0], K[1, 1], K[0, 1], K[0, 2], K[1, 2])
        centre = ", ".join(f"{value:.1f}" for value in camera.centre_mm)
        rows.append([detector, *(f"{v:.1f} ± {s:.1f}" for v, s in zip(values, sd, strict=False)), centre])
    return _table(["detector", "fx, px", "fy, px", "skew, px", "cx, px", "cy, px", "source in the world, mm"], rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m guide3d.calibration",
        description="Calibrate detectors from images of a sheet and a bead cube.",
    )
    parser.add_argument(
        "folder", help="with undistort_<detector>.*, <pose>_<detector>.*, framespec_cm.csv and, if any, *.ref"
    )
    parser.add_argument("--output", required=True, help="folder for the report, the cameras and the distortion maps")
    parser.add_argument("--swirl", choices=("auto", "never", "always"), default="auto", help="correct a turned field")
    parser.add_argument("--verbose", action="store_true")
    chosen = parser.parse_args(arguments)
    logging.basicConfig(level=logging.DEBUG if chosen.verbose else logging.INFO, format="%(message)s")
    try:
        calibration = calibrate_folder(chosen.folder, chosen.swirl)
        page = write_report(calibration, chosen.folder, chosen.output)
    except (OSError, ValueError) as error:
        sys.stderr.write(f"{in_words(error)}\n")
        return 1
    for detector, own in figures(calibration).items():
        for pose, image in own["images"].items():
            sys.stdout.write(
                f"{pose}, detector {detector}: {own['holes']} holes, {image['beads']} beads, "
                f"mean {image['mean_px']:.2f} px\n"
            )
    for warning in calibration.warnings:
        sys.stdout.write(f"{warning}\n")
    sys.stdout.write(f"{page}\n")
    return 0


if __name__ == "__main__":
    run(main)
