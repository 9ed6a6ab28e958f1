"""Cases of a claim of real X-ray pairs, which are not public: a pair of images each, read at a size."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.data.sources import private_data
from pipeline.protocol.claims import RealXray
from pipeline.store.atomic_files import read_json

if TYPE_CHECKING:
    from guide3d.geometry.polyline import Array

_NEAR_PX, _WIDTH_PX, _FAILED_MM = 4.0, 6, 100.0


def cases(claim: RealXray, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: a pair and the size that its images are given; no seed changes them."""
    names = [f"pair{entry['pair']:02d}" for entry in _pairs()]
    yield from ({"anatomy": name, "variation": f"size {size:g}"} for size in claim.sizes for name in names)


def play(claim: RealXray, case: dict[str, Any]) -> dict[str, Any]:
    """Reads both images of a pair, at size 1 also the wire in space.

    Returns:
        Means over both images, in px of the images as recorded: `dice` of curves drawn 6 px wide, `within_4px_pct` (of
        the annotation from the curve), `curve_mean_px` and `tip_px`; `mean_mm` (nearest distances both ways from the
        annotation's reconstruction, up to the shorter one's length) and `tip_mm`; `success`: whether the reading was
        accepted, at other sizes whether there is a wire in both images.
    """
    from guide3d.geometry.metrics import chamfer, mete
    from guide3d.reading.pair_reading import combine
    from guide3d.reconstruction.reconstruction import reconstruct

    size, name = float(case["variation"].split()[1]), case["anatomy"]
    cameras, distortions, annotations = _rig()
    views, figures = zip(
        *(_read(name, view, curve, size) for view, curve in zip("ab", annotations[name], strict=True)), strict=True
    )
    view_means = {key: round(float(np.mean([one[key] for one in figures])), 3) for key in figures[0]}
    if size != 1:
        return {"success": all(view.found for view in views)} | view_means
    curves = annotations[name]
    if distortions is not None:
        curves = [own.undistort_points(curve) for own, curve in zip(distortions, curves, strict=True)]
    truth = reconstruct(*cameras, *curves).curve_mm
    try:
        result = combine(list(views), cameras, distortions)
    except ValueError as error:
        return {"success": False, "reason": str(error), "mean_mm": _FAILED_MM, "tip_mm": _FAILED_MM} | view_means
    distances = chamfer(*_in_common(truth, result.curve_mm)), mete(truth, result.curve_mm)
    mean, tip = (round(min(float(distance), _FAILED_MM), 3) for distance in distances)
    return {"success": bool(result.accepted), "mean_mm": mean, "tip_mm": tip} | view_means


def _pairs() -> list[dict[str, Any]]:
    pairs: list[dict[str, Any]] = read_json(private_data("stereo_pairs.json"))["pairs"]
    return pairs


@lru_cache(maxsize=1)
def _rig() -> tuple[Any, Any, dict[str, list[Array]]]:
    """Cameras; distortions, or None where the annotations are undistorted already; the annotated curves by pair, px."""
    from guide3d.calibration.folder import distortions_of, rigs_in
    from guide3d.reconstruction.view_checks import epipolar_residuals, undistorted_or_raw

    folder = private_data("xray_calibration")
    curves = {
        f"pair{entry['pair']:02d}": [np.array(entry[f"camera_{view}"], float) for view in "ab"] for entry in _pairs()
    }
    both = [(a, b) for a, b in curves.values()]
    rig = min(
        rigs_in(folder), key=lambda rig: float(np.median(epipolar_residuals(rig.cameras[0], rig.cameras[1], both)))
    )
    distortions = distortions_of(folder)
    if distortions is not None:
        undistort = [distortion.undistort_points for distortion in distortions]
        distortions = distortions if undistorted_or_raw(*rig.cameras, both, *undistort).answer == "raw" else None
    return rig.cameras, distortions, curves


def _read(name: str, view: str, curve: Array, size: float) -> tuple[Any, dict[str, float]]:
    """The reading of an image, and its figures."""
    from guide3d.geometry.polyline import distances_to, resample
    from guide3d.image_file import read_grey_levels
    from guide3d.opencv import cv2
    from guide3d.reading.image_reading import read, shipped_reader

    image = read_grey_levels(private_data("xray_wires") / f"{name}_{view}.png")
    how = cv2.INTER_AREA if size < 1 else cv2.INTER_LINEAR
    reading = read(
        image if size == 1 else cv2.resize(image, None, fx=size, fy=size, interpolation=how), shipped_reader()
    )
    if not reading.found:
        far = float(np.hypot(*image.shape[:2]))
        return reading, {"dice": 0.0, "within_4px_pct": 0.0, "curve_mean_px": far, "tip_px": far}
    points, truth = (reading.points_px + 0.5) / size - 0.5, resample(curve, spacing=1.0)
    off = distances_to(points, truth)
    drawn = [_drawn(image.shape, line) for line in (resample(points, spacing=1.0), truth)]
    return reading, {
        "dice": float(2 * (drawn[0] & drawn[1]).sum() / max(sum(int(mask.sum()) for mask in drawn), 1)),
        "within_4px_pct": 100 * float((off <= _NEAR_PX).mean()),
        "curve_mean_px": float(off.mean()),
        "tip_px": float(np.hypot(*(points[0] - curve[0]))),
    }


def _drawn(shape: tuple[int, ...], points: Array) -> Any:
    from guide3d.opencv import cv2

    canvas = np.zeros(shape[:2], np.uint8)
    cv2.polylines(canvas, [np.rint(points * 16).astype(np.int32)], False, 1, _WIDTH_PX, cv2.LINE_8, 4)
    return canvas > 0


def _in_common(a: Array, b: Array) -> tuple[Array, Array]:
    """Cuts the longer of two curves, tip first, to the length of the shorter one."""
    from guide3d.geometry.polyline import arc_length, at_length

    length = min(float(arc_length(curve)[-1]) for curve in (a, b))
    along = np.append(np.arange(0.0, length, 0.5), length)
    return at_length(a, along), at_length(b, along)
