"""Measures real calibration images and their simulated counterparts in the same way, and shows them side by side.

    python docs/pictures/compare_fluoroscopy.py REAL OUT

REAL holds calibration1_16710.jpg, calibration1_16709.jpg (the bead cube) and undistort_16710.jpg, undistort_16709.jpg
(the perforated sheet), 1,024 px. OUT gets one picture an object and camera, the real image on the left.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from fluoroscopy_pictures import bead_cube, perforated_sheet
from PIL import Image
from scipy import ndimage, optimize, special

from cathsim.fluoroscopy import guide3d_pair

PATCH = 32  # px
NUMBERS = {"a": "16710", "b": "16709"}


def flat_residuals(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Patches without structure: their mean grey levels (n,), and what a quadratic leaves of them (n, 32, 32)."""
    y, x = np.mgrid[:PATCH, :PATCH] / PATCH
    basis = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6))[0]
    blocks = image.reshape(-1, PATCH, image.shape[1] // PATCH, PATCH).swapaxes(1, 2).reshape(-1, PATCH * PATCH)
    rest = (blocks - blocks @ basis @ basis.T).reshape(-1, PATCH, PATCH)
    smooth = ndimage.gaussian_filter(rest, (0, 3, 3))
    flat = (smooth.std(axis=(1, 2)) < 0.45 * rest.std(axis=(1, 2))) & (rest.std(axis=(1, 2)) < 8)
    return blocks.mean(axis=1)[flat], rest[flat]


def noise(image: np.ndarray) -> dict[str, float]:
    """Standard deviation at several grey levels, and correlation of neighbours."""
    grey, rest = flat_residuals(image)
    sd = rest.std(axis=(1, 2))
    figures = {
        f"noise sd at grey {low}-{low + 30}": float(np.median(sd[(grey >= low) & (grey < low + 30)]))
        for low in (75, 105, 135)
        if ((grey >= low) & (grey < low + 30)).sum() > 5
    }
    power = np.mean(np.abs(np.fft.fft2(rest[(grey > 70) & (sd < 5)])) ** 2, axis=0)
    correlation = np.fft.ifft2(power).real
    for shift in (1, 2, 3):
        both = correlation[0, shift] + correlation[shift, 0]
        figures[f"noise correlation at {shift} px"] = float(both / 2 / correlation[0, 0])
    return figures


def field(image: np.ndarray) -> dict[str, float]:
    """Circle of the collimator, fall of the light towards it, and the dark outside."""
    smooth = ndimage.gaussian_filter(ndimage.grey_closing(image, 15), 1.5)
    middle, radius = np.array([511.5, 511.5]), 0.0
    for _ in range(3):
        found = []
        for angle in np.radians(np.arange(0, 360, 1)):
            r = np.arange(380, 760)
            at = middle[:, None] + r * np.array([[np.cos(angle)], [np.sin(angle)]])
            inside = ((at > 3) & (at < 1020)).all(axis=0)
            if inside.sum() < 40:
                continue
            values = ndimage.map_coordinates(smooth, at[::-1][:, inside], order=1)
            edge = int(np.argmin(np.gradient(values)))
            if 12 < edge < len(values) - 10 and values[edge - 12] > 35 and values[edge + 9] < 45:
                found.append(at[:, inside][:, edge])
        points = np.array(found)
        fit = optimize.least_squares(
            lambda q, points=points: np.hypot(*(points - q[:2]).T) - q[2], [*middle, 600], loss="soft_l1", f_scale=3
        )
        middle, radius = fit.x[:2], fit.x[2]
    v, u = np.mgrid[:1024, :1024]
    r = np.hypot(u - middle[0], v - middle[1])
    lit = np.median(smooth[r < 40])
    return {
        "field radius, px": float(radius),
        **{
            f"grey at {share} of the radius over the middle": _ring(smooth, r, share * radius) / lit
            for share in (0.6, 0.9)
        },
        "grey outside": float(np.median(image[r > radius + 30])),
        "grey in the middle": float(lit),
    }


def _ring(image: np.ndarray, r: np.ndarray, radius: float) -> float:
    return float(np.median(image[np.abs(r - radius) < 10]))


def beads(image: np.ndarray) -> dict[str, float]:
    """Grey level in the middle of beads over that around them, and the width of their edges."""
    around = ndimage.grey_closing(ndimage.gaussian_filter(image, 2), 45)
    label, _ = ndimage.label((image < 0.55 * around) & (around > 60))
    v, u = np.mgrid[:1024, :1024]
    ratios, edges = [], []
    for index, box in enumerate(ndimage.find_objects(label), start=1):
        height, width = (side.stop - side.start for side in box)
        if not (70 < (label[box] == index).sum() < 300 and abs(height - width) <= 3):
            continue
        row, column = ndimage.center_of_mass(label == index)
        if not (25 < row < 998 and 25 < column < 998):
            continue
        r = np.hypot(u - column, v - row)
        dark, bright = image[r < 2].mean(), np.median(image[(r > 14) & (r < 18)])
        near = r < 14
        profile = (image[near] - dark) / (bright - dark)
        (_, sigma), _ = optimize.curve_fit(
            lambda d, radius, s: 0.5 * (1 + special.erf((d - radius) / (s * 2**0.5))), r[near], profile, [7.0, 1.5]
        )
        ratios.append(dark / bright)
        edges.append(abs(sigma))
    return {
        "beads found": len(edges),
        "bead over surroundings": float(np.median(ratios)),
        "edge width (sigma), px": float(np.median(edges)),
    }


def sheet(image: np.ndarray) -> dict[str, float]:
    """Grey levels of holes and web near the middle, and the grey of the holes outwards."""
    part = image[412:612, 412:612]
    return {"sheet, hole": float(np.percentile(part, 95)), "sheet, web": float(np.percentile(part, 5))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("real", type=Path, help="folder of the real images")
    parser.add_argument("out", type=Path, help="folder for the pictures, outside the repository's tracked files")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for camera in guide3d_pair(np.zeros(3)):
        number = NUMBERS[camera.name]
        for stem, make in (("calibration1", bead_cube), ("undistort", perforated_sheet)):
            real = np.asarray(Image.open(options.real / f"{stem}_{number}.jpg").convert("L"))
            ours = make(camera)
            Image.fromarray(np.concatenate((real, ours), axis=1)).save(options.out / f"{stem}_{camera.name}.png")
            columns = []
            for image in (real.astype(float), ours.astype(float)):
                columns.append(
                    {**noise(image), **field(image), **beads(image)}
                    if stem == "calibration1"
                    else {**field(image), **sheet(image)}
                )
            print(f"\ncamera {camera.name} ({number}), {stem:14}{'real':>24}{'simulated':>12}")
            for key, value in columns[0].items():
                print(f"  {key:50}{value:12.3f}{columns[1].get(key, float('nan')):12.3f}")


if __name__ == "__main__":
    main()
