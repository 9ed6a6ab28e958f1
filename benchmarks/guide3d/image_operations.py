"""Image operations by OpenCV beside what they replaced (SciPy, Pillow, PyTorch), and camera models beside OpenCV's.

    python benchmarks/guide3d/image_operations.py [--repeats 5]

Processor time of one thread, the least of some repeats, on a drawn X-ray of 1,024 px; the largest difference between
both results. Triangulation: of points of a drawn rig, in mm from the true points, exact and with 0.5 px of noise.
Prints a table, and one JSON object last.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from PIL import Image
from scipy import ndimage
from torch.nn import functional as F

from guide3d.geometry.triangulation import triangulate, triangulate_linear
from guide3d.image_file import encode_png
from guide3d.image_filters import blurred, closed, laplacian, largest_around, mean_around, sampled, white_tophat
from guide3d.learning.preprocessing import averaged, dark_lines
from guide3d.opencv import cv2
from guide3d.reconstruction.synthetic_scene import scenes
from splineformer.learning.augmentation import warped

SIZE = 1024
Call = Callable[[], Any]


def drawn_xray(seed: int = 0) -> np.ndarray:
    """(SIZE, SIZE) uint8: shades, a dark line, noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:SIZE, :SIZE]
    grey = 120 + 50 * np.sin(x / 211) * np.cos(y / 170) + rng.normal(0, 4, (SIZE, SIZE))
    grey *= np.where(np.abs(x - 500 - 200 * np.sin(y / 150)) < 3, 0.7, 1.0)
    return np.clip(grey, 0, 255).astype(np.uint8)


def operations(image: np.ndarray) -> Iterator[tuple[str, Call, Call]]:
    """Name, what was called before, and what is called now."""
    grey, fine = image.astype(float), image.astype(np.float32)
    y, x = np.mgrid[:SIZE, :SIZE].astype(float)
    columns, rows = x + 8 * np.sin(y / 200), y + 9 * np.cos(x / 170)
    maps = columns.astype(np.float32), rows.astype(np.float32)
    wire = image < 90
    old = Image.fromarray(image)

    def pillow_png() -> bytes:
        stream = io.BytesIO()
        old.save(stream, "PNG", compress_level=1, compress_type=2)
        return stream.getvalue()

    def scipy_lines() -> np.ndarray:
        smooth = ndimage.uniform_filter(image, 3, mode="nearest")
        wide = ndimage.maximum_filter(smooth, 13, mode="nearest")
        return ndimage.minimum_filter(wide, 13, mode="nearest") - smooth

    def remapped() -> np.ndarray:
        return np.asarray(cv2.remap(fine, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def distance() -> np.ndarray:
        return np.asarray(cv2.distanceTransform(wire.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))

    yield "Gaussian 2.3 px, float64", lambda: ndimage.gaussian_filter(grey, 2.3), lambda: blurred(grey, 2.3)
    yield "Gaussian 2.3 px, float32", lambda: ndimage.gaussian_filter(fine, 2.3), lambda: blurred(fine, 2.3)
    yield "Laplacian of Gaussian 3.5 px", lambda: ndimage.gaussian_laplace(fine, 3.5), lambda: laplacian(fine, 3.5)
    yield "greatest within 9 px", lambda: ndimage.maximum_filter(grey, 9), lambda: largest_around(grey, 9)
    yield "closing 25 px, float64", lambda: ndimage.grey_closing(grey, 25), lambda: closed(grey, 25)
    yield "white top-hat 10 px", lambda: ndimage.white_tophat(grey, size=10), lambda: white_tophat(grey, 10)
    yield "line filter 13 px, uint8", scipy_lines, lambda: dark_lines(image, 13)
    yield "mean 25 px", lambda: ndimage.uniform_filter(fine, 25, mode="nearest"), lambda: mean_around(fine, 25)
    yield (
        "remap, a map for each pixel",
        lambda: ndimage.map_coordinates(fine, [rows, columns], order=1, mode="nearest"),
        remapped,
    )
    yield (
        "values at 1,024 x 1,024 places",
        lambda: ndimage.map_coordinates(fine, [rows, columns], order=1, mode="nearest"),
        lambda: sampled(fine, columns, rows),
    )
    yield (
        "1,024 to 256 px",
        lambda: np.asarray(old.resize((256, 256), Image.Resampling.BOX)),
        lambda: averaged(image, 256),
    )
    yield "distance transform", lambda: ndimage.distance_transform_edt(wire), distance
    yield (
        "number of pieces",
        lambda: ndimage.label(wire, np.ones((3, 3)))[1],
        lambda: cv2.connectedComponents(wire.astype(np.uint8), connectivity=8)[0] - 1,
    )
    png = encode_png(image)
    data = np.frombuffer(png, np.uint8)
    yield "PNG written (bytes)", lambda: len(pillow_png()), lambda: len(encode_png(image))
    yield "PNG read", lambda: np.asarray(Image.open(io.BytesIO(png))), lambda: cv2.imdecode(data, 0)
    batch = torch.from_numpy(np.ascontiguousarray(fine.reshape(4, 256, 4, 256).transpose(0, 2, 1, 3)[:3]))
    batch = batch.reshape(12, 1, 256, 256)
    angle, size = 0.1, 1.05
    turn = size * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    ways = np.repeat(np.column_stack([turn, [0.03, -0.05]])[None], len(batch), 0)
    yield "12 pictures of 256 px turned", lambda: _turned(batch, ways).numpy(), lambda: warped(batch, ways).numpy()


def _turned(images: torch.Tensor, maps: np.ndarray) -> torch.Tensor:
    linear = np.linalg.inv(maps[:, :, :2])
    offset = 2 * (linear @ (0.5 - maps[:, :, 2:]))[:, :, 0] - 1
    theta = torch.from_numpy(np.concatenate([linear, offset[:, :, None]], 2).astype(np.float32))
    grid = F.affine_grid(theta, list(images.shape), align_corners=False)
    return F.grid_sample(images, grid, align_corners=False)


def cameras(repeats: int) -> dict[str, dict[str, float]]:
    """Projection and triangulation of a drawn rig: ms for 2,000 points, and mm from the true points."""
    scene = next(iter(scenes(1, seed=0)))
    a, b = scene.cameras
    middle = scene.curve_mm.mean(axis=0)
    points = middle + np.random.default_rng(0).normal(scale=25.0, size=(2_000, 3))
    exact = a.project(points), b.project(points)
    rng = np.random.default_rng(1)
    noisy = tuple(pixels + rng.normal(scale=0.5, size=pixels.shape) for pixels in exact)

    def opencv(pixels: tuple[np.ndarray, ...]) -> np.ndarray:
        found = cv2.triangulatePoints(a.P, b.P, pixels[0].T, pixels[1].T)
        return np.asarray((found[:3] / found[3]).T)

    def opencv_projection() -> np.ndarray:
        turn, _ = cv2.Rodrigues(a.R)
        return np.asarray(cv2.projectPoints(points, turn, a.t_mm, a.K, None)[0][:, 0])

    rows = {}
    for name, way in (
        ("OpenCV triangulatePoints", opencv),
        ("linear, equations in mm", lambda pixels: triangulate_linear(a, b, *pixels)),
        ("least squares in the images", lambda pixels: triangulate(a, b, *pixels)),
    ):
        milliseconds = cpu_ms(lambda way=way: way(noisy), repeats)[1]
        errors = [float(np.sqrt(((way(pixels) - points) ** 2).sum(axis=1).mean())) for pixels in (exact, noisy)]
        seen = np.concatenate([camera.project(way(noisy)) for camera in (a, b)]) - np.concatenate(noisy)
        residual = float(np.sqrt((seen**2).sum(axis=1).mean()))
        rows[name] = {"ms": milliseconds, "exact_mm": errors[0], "noisy_mm": errors[1], "residual_px": residual}
    off = np.abs(opencv_projection() - exact[0]).max()
    rows["OpenCV projectPoints"] = {"ms": cpu_ms(opencv_projection, repeats)[1], "off_px": float(off)}
    rows["Camera.project"] = {"ms": cpu_ms(lambda: a.project(points), repeats)[1], "off_px": 0.0}
    return rows


def cpu_ms(call: Call, repeats: int) -> tuple[Any, float]:
    """The result of a call, and its least processor time."""
    result, least = call(), np.inf
    for _ in range(repeats):
        began = time.process_time()
        call()
        least = min(least, time.process_time() - began)
    return result, 1e3 * float(least)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    torch.set_num_threads(1)
    results = {}
    print(f"{'operation':32} {'before':>9} {'OpenCV':>9} {'factor':>7} {'largest difference':>20}   (ms)")
    for name, before, now in operations(drawn_xray()):
        old, old_ms = cpu_ms(before, repeats)
        new, new_ms = cpu_ms(now, repeats)
        off = float(np.abs(np.asarray(old, float) - np.asarray(new, float)).max())
        results[name] = {"before_ms": old_ms, "now_ms": new_ms, "difference": off}
        print(f"{name:32} {old_ms:9.2f} {new_ms:9.2f} {old_ms / new_ms:7.1f} {off:20.2g}")
    models = cameras(repeats)
    print()
    for name, row in models.items():
        print(f"{name:32} " + "  ".join(f"{key} {value:.4g}" for key, value in row.items()))
    print(json.dumps({"operations": results, "cameras": models}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
