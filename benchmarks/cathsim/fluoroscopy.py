"""Bi-planar fluoroscopy: time to render, and how exactly image, mask and projected wire agree.

    python benchmarks/cathsim/fluoroscopy.py [--quick] [--frames N]

The wire for registration is a curve given in closed form, no spline: it is sampled every 2 mm for the renderer, and
every 0.05 mm for the truth, which goes through the exported matrix P and the distortion and never through the renderer.
Across the truth, every 2 px, the centroid of the wire's absorbance is measured in the image.

Prints a table and, as its last line, one JSON object:
    pair_1024_ms, pair_512_ms, pair_128_ms
                            processor time for images and masks of both cameras with noise, one thread, median
    devices_512_ms          the same for a wire in a catheter, 60 mm ahead of it
    frontal_80_us, frontal_80_devices_us
                            processor time for the simple frontal image and mask of an environment, 80 px, and for that
                            of two devices with their masks, in microseconds, median
    setup_s                 processor time for what is computed once a phantom and geometry at 1,024 px
    registration_px         mean distance of the centroid from the true line, image without noise, worst camera
    registration_p95_px     95th percentile of the same
    registration_noisy_px   mean distance over one noisy frame, centroids averaged over 20 px of wire
    mask_px                 mean distance of the mask's middle from the true line, across it
    undistorted_px          the error that ignoring the distortion would make, mean along the same wire
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable, Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy import ndimage

from cathsim import NavigateEnv, load_catheter, load_phantom
from cathsim.fluoroscopy import BiplaneFluoroscope
from cathsim.observations.fluoroscopes import material_of

ACROSS = np.linspace(-8.0, 8.0, 161)  # px on both sides of the line
PITCH_PX = 2.0
AHEAD = 10  # nodes of the wire, 6 mm apart, that are ahead of the catheter
AVERAGED = 10  # samples of the noisy image that are averaged, 20 px


def wire(spacing: float) -> np.ndarray:
    """A wire that rises, bends over and winds, inside both fields of view, m. Shape (n, 3)."""
    fine = np.linspace(0.0, 1.0, 20001)
    angle = 3.4 * fine
    points = np.stack(
        (
            0.030 - 0.055 * np.sin(angle) ** 2 + 0.004 * np.sin(16 * fine),
            0.016 * np.cos(2.1 * angle),
            -0.070 + 0.130 * fine + 0.006 * np.cos(11 * fine),
        ),
        axis=1,
    )
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    at = np.linspace(0.0, arc[-1], round(arc[-1] / spacing) + 1)
    return np.stack([np.interp(at, arc, points[:, k]) for k in range(3)], axis=1)


def true_line(fluoroscope: BiplaneFluoroscope, name: str, *, distorted: bool = True) -> np.ndarray:
    """The wire in a camera's image by its exported matrix and distortion, px. Shape (n, 2)."""
    camera = fluoroscope.cameras[name]
    P = np.array(fluoroscope.to_json()[name]["P"])
    points = wire(5e-5)
    homogeneous = np.column_stack((points, np.ones(len(points)))) @ P.T
    ideal = homogeneous[:, :2] / homogeneous[:, 2:]
    return camera.distortion.distort(ideal) if distorted else ideal


def samples_across(line: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Points every 2 px of a line that lie well inside the image, and its unit normals there. Shapes (n, 2)."""
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    at = np.arange(10.0, arc[-1] - 10.0, PITCH_PX)
    points = np.stack([np.interp(at, arc, line[:, k]) for k in range(2)], axis=1)
    tangent = np.gradient(points, axis=0)
    normal = np.stack((-tangent[:, 1], tangent[:, 0]), axis=1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    keep = (np.abs(points - (size - 1) / 2) < size / 2 - 40).all(axis=1)
    # the centroid means something only where no other stretch of the wire is near
    for j in np.flatnonzero(keep):
        others = np.abs(np.arange(len(points)) - j) > 20
        keep[j] = np.linalg.norm(points[others] - points[j], axis=1).min() > 25
    return points[keep], normal[keep]


def profiles(picture: np.ndarray, points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Values across the line. Shape (n, across)."""
    at = points[:, None] + ACROSS[None, :, None] * normal[:, None]
    return ndimage.map_coordinates(picture, [at[..., 1], at[..., 0]], order=1)


def offsets(absorbance: np.ndarray) -> np.ndarray:
    """Centroid of every profile, px from the line. Shape (n,)."""
    return (absorbance * ACROSS).sum(axis=1) / absorbance.sum(axis=1)


def registration(fluoroscope: BiplaneFluoroscope, name: str, size: int) -> dict[str, float]:
    """Distances of image and mask from the projected wire, px."""
    nodes = wire(0.002)
    points, normal = samples_across(true_line(fluoroscope, name), size)
    empty = fluoroscope.render(np.zeros((0, 3)))[name].image.astype(float) + 0.5
    clean = fluoroscope.render(nodes)[name]
    # the display shows the square root of the light
    shadow = profiles(1 - np.square((clean.image + 0.5) / empty), points, normal)
    shift = offsets(np.where(shadow > 0.04, shadow, 0.0))
    noisy = fluoroscope.render(nodes, 0)[name].image + 0.5
    rough = profiles(1 - np.square(noisy / empty), points, normal)
    kept = rough[: len(rough) // AVERAGED * AVERAGED].reshape(-1, AVERAGED, len(ACROSS)).mean(axis=1)
    kept = kept[:, np.abs(ACROSS) <= 5]
    rough_shift = (kept * ACROSS[np.abs(ACROSS) <= 5]).sum(axis=1) / kept.sum(axis=1)
    mask = profiles(clean.mask.astype(float), points, normal)
    far = true_line(fluoroscope, name) - true_line(fluoroscope, name, distorted=False)
    return {
        "registration_px": float(np.abs(shift).mean()),
        "registration_p95_px": float(np.percentile(np.abs(shift), 95)),
        "registration_noisy_px": float(np.abs(rough_shift).mean()),
        "mask_px": float(np.abs(offsets(mask)).mean()),
        "undistorted_px": float(np.linalg.norm(far, axis=1).mean()),
        "samples": len(points),
    }


def median_ms(draw: Callable[[int], object], frames: int) -> float:
    """Median processor time of drawing one frame of a number, ms."""
    draw(0)
    spent = []
    for frame in range(frames):
        start = time.process_time()
        draw(frame)
        spent.append(1e3 * (time.process_time() - start))
    return statistics.median(spent)


def pair_ms(fluoroscope: BiplaneFluoroscope, frames: int) -> float:
    """Median processor time of a pair of images with masks, ms."""
    nodes = wire(0.006)
    return median_ms(lambda frame: fluoroscope.render(nodes, frame), frames)


def devices_ms(fluoroscope: BiplaneFluoroscope, frames: int) -> float:
    """The same of a wire in a catheter."""
    nodes = wire(0.006)
    both = fluoroscope.with_catheter(material_of(load_catheter("vertebral")))
    return median_ms(lambda frame: both.render_devices(nodes, nodes[AHEAD:], frame), frames)


def frontal_us(catheter: str | None, frames: int) -> float:
    """Median processor time of an environment's simple frontal image and masks, microseconds."""
    environment = NavigateEnv("type_1", "lcca", catheter=catheter, image_size=80, observation="tip")
    environment.reset(seed=0)
    for _ in range(60):
        environment.step(np.array([1.0, 0.3, 0.5, 0.3] if catheter else [1.0, 0.3]))
    fluoroscope = environment.fluoroscope

    def draw(_: int) -> None:
        fluoroscope.update()
        fluoroscope.image()
        fluoroscope.mask()

    return 1e3 * median_ms(draw, 20 * frames)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer frames")
    parser.add_argument("--frames", type=int, default=100, help="frames a size")
    options = parser.parse_args(arguments)
    frames = min(options.frames, 20) if options.quick else options.frames
    phantom = load_phantom("type_1")
    start = time.process_time()
    fluoroscope = BiplaneFluoroscope.of(phantom)
    result: dict[str, float] = {"setup_s": time.process_time() - start}
    for size in (1024, 512, 128):
        result[f"pair_{size}_ms"] = pair_ms(
            fluoroscope if size == 1024 else BiplaneFluoroscope.of(phantom, size=size), frames
        )
    result["devices_512_ms"] = devices_ms(BiplaneFluoroscope.of(phantom, size=512), frames)
    result["frontal_80_us"] = frontal_us(None, frames)
    result["frontal_80_devices_us"] = frontal_us("vertebral", frames)
    rows = {name: registration(fluoroscope, name, 1024) for name in fluoroscope.names}
    print(f"{'':24}" + "".join(f"{'camera ' + name:>12}" for name in rows))
    for key in next(iter(rows.values())):
        print(f"{key:24}" + "".join(f"{row[key]:12.3f}" for row in rows.values()))
        if key != "samples":
            result[key] = max(row[key] for row in rows.values())
    timed = ("pair_1024_ms", "pair_512_ms", "pair_128_ms", "devices_512_ms", "frontal_80_us", "frontal_80_devices_us")
    for key in (*timed, "setup_s"):
        print(f"{key:24}{result[key]:12.2f}")
    print(json.dumps({key: round(value, 4) for key, value in result.items()}))


if __name__ == "__main__":
    main()
