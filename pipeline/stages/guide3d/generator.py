"""The generator of Guide3D data sets: simulated wires, their bi-planar images, annotations and true curves."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from guide3d.calibration.hexagonal_lattice import lattice_points
from guide3d.dataset.annotation_files import DETECTOR, Annotation, Views, image_name, write_curves, write_raw
from guide3d.dataset.cvat import write_cvat
from guide3d.dataset.dataset import CURVES, PROPERTIES, RAW, TRUTH
from guide3d.dataset.true_curves import TrueCurve, write_truth
from guide3d.geometry.bspline import BSplineCurve, fit_bspline
from guide3d.geometry.camera import Camera, write_camera
from guide3d.geometry.distortion import Distortion
from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.annotation import annotated, in_view, thinned_by_turning
from pipeline.stages.guide3d.plan import Acquisition
from pipeline.stages.guide3d.wire_motions import Operator
from pipeline.store.atomic_files import write_json, write_text

if TYPE_CHECKING:
    from cathsim.fluoroscopy import BiplaneFluoroscope, XRayCamera

DATASET, TAKES = "dataset", ".takes"  # the latter until the stage is done
_MM = 1e3
_CURVE_SPACING = 0.25e-3  # m, of the samples that are projected: a little over a pixel
_TRUTH = 5.0, 0.05  # mm and rad between the points of a true curve: chords within 0.01 mm
_TIP_MARGIN_PX = 10.0  # a tip nearer to the border than this is drawn back
# The shafts of six published pairs run 6 degrees out of the plane of both optical axes, so the patient lies askew by as
# much. In that plane a whole shaft would lie on one epiline, and its depth would be anyone's guess.
_ASKEW = np.radians(6.0)
_SHEET_PITCH = 0.0142  # of the image's side, of the holes that stand for a data set's known distortion
_SPLINE_PX = 0.05  # b_spline.json's curves keep this near to exact annotations, and to clicks as near as their noise


@dataclass(frozen=True)
class Studio:
    """How every acquisition of a data set is made.

    Attributes:
        centre: (3,) m, where the axes of both cameras meet.
        image_size_px: side of the images.
        distorted: images as the detectors show them, and annotations on those; or both undistorted.
        annotation_noise_px: standard deviation of a click; 0: exact annotations.
        filling: of the lumen with fluid, "fluid" (clear) or "contrast"; without it is air.
    """

    centre: tuple[float, float, float]
    image_size_px: int
    distorted: bool
    annotation_noise_px: float
    filling: str


@dataclass(frozen=True)
class GenerationJob:
    """Acquisitions to be made by one process.

    Attributes:
        folder: of the stage.
        acquisitions: to be made.
        studio: how.
    """

    folder: Path
    acquisitions: tuple[Acquisition, ...]
    studio: Studio


def cameras_of(studio: Studio) -> dict[str, XRayCamera]:
    """Cameras "a" and "b" of the public data set's geometry."""
    from cathsim.fluoroscopy import PAIRS, Distortion

    size = studio.image_size_px
    cameras = {camera.name: camera for camera in _askew(PAIRS["guide3d"](studio.centre, size), studio.centre)}
    if not studio.distorted:
        none = Distortion.none(size, size)
        cameras = {name: dataclasses.replace(camera, distortion=none) for name, camera in cameras.items()}
    return cameras


def _askew(pair: Sequence[XRayCamera], centre: Sequence[float]) -> list[XRayCamera]:
    """The pair turned by `_ASKEW` about the middle of its viewing directions, through the point where its axes meet."""
    a, b = (camera.projector for camera in pair)
    axis = (a.R[2] + b.R[2]) / np.linalg.norm(a.R[2] + b.R[2])
    turn = Rotation.from_rotvec(_ASKEW * axis).as_matrix()
    turned = []
    for camera in pair:
        projector, R = camera.projector, camera.projector.R @ turn.T
        source = np.asarray(centre) + turn @ (projector.source - np.asarray(centre))
        turned.append(dataclasses.replace(camera, projector=dataclasses.replace(projector, R=R, t=-R @ source)))
    return turned


def generate(job: GenerationJob, report: Report) -> dict[str, Any]:
    """Makes acquisitions that are not made yet; an interrupted one is made again.

    Args:
        job: what to make.
        report: takes the progress.

    Returns:
        ``pairs`` and, by motion, how often it was filmed.
    """
    studio, motions = job.studio, dict[str, int]()
    pairs, total = 0, sum(acquisition.script.shapes for acquisition in job.acquisitions)
    for acquisition in job.acquisitions:
        record = job.folder / TAKES / f"{acquisition.name}.json"
        if not record.exists():
            take = _film(acquisition, studio, job.folder / DATASET / "images", report.part(pairs / total, 1.0))
            write_text(record, json.dumps(take))  # last: what has no record is made again
        motion = json.loads(record.read_text(encoding="utf-8"))["motion"]
        motions[motion] = motions.get(motion, 0) + 1
        pairs += acquisition.script.shapes
        report(pairs / total, f"{pairs} of {total} pairs")
    return {"pairs": pairs, "motions": motions}


def _film(acquisition: Acquisition, studio: Studio, images: Path, report: Any) -> dict[str, Any]:
    from cathsim.fluoroscopy.curve import smooth_curve

    script = acquisition.script
    cameras, operator = cameras_of(studio), _operator(script.phantom, script.wire)
    bounds, grid = operator.phantom.bounds, operator.phantom.grid
    margin = np.array([_TIP_MARGIN_PX, studio.image_size_px - 1 - _TIP_MARGIN_PX])

    def seen(tip: np.ndarray) -> bool:
        """In both images, and not beyond the open end of a vessel."""
        places = np.array([camera.pixels(tip[None])[0] for camera in cameras.values()])
        inside = (bounds[0] < tip).all() and (tip < bounds[1]).all() and float(grid.sample(tip)) > -1e-3
        return bool(inside and (places > margin[0]).all() and (places < margin[1]).all())

    motion, shapes = operator.film(script, seen)
    fluoroscope = _fluoroscope(script.phantom, script.wire, acquisition.fluid, studio)
    generator = np.random.default_rng((script.seed, 1_000))
    frames = []
    for number, nodes in enumerate(shapes):
        curve, arc = smooth_curve(nodes, _CURVE_SPACING)
        frame: dict[str, Any] = {"number": number, "visible_mm": {}, "points": {}}
        for name, camera in cameras.items():
            view = in_view(camera.pixels(curve), arc, studio.image_size_px)
            assert view is not None  # the tip is in view
            points = annotated(view.points, studio.annotation_noise_px, studio.image_size_px, generator)
            frame["points"][name] = np.round(points, 2).tolist()
            frame["visible_mm"][name] = view.visible * _MM
        kept = arc <= max(frame["visible_mm"].values()) / _MM + 2 * _CURVE_SPACING
        frame["curve_mm"] = np.round(thinned_by_turning(_MM * curve[kept], *_TRUTH), 4).tolist()
        for name, picture in fluoroscope.render(nodes, seed=int(generator.integers(2**63))).items():
            path = images / image_name(acquisition.name, name, number)
            path.parent.mkdir(parents=True, exist_ok=True)
            # noise hardly shrinks: coding its bytes by frequency alone is fastest, and smaller than the fastest deflate
            Image.fromarray(picture.image).save(path, compress_level=1, compress_type=2)
        frames.append(frame)
        report(len(frames) / len(shapes))
    return {"name": acquisition.name, "fluid": acquisition.fluid, "wire": script.wire, "motion": motion,
            "phantom": script.phantom, "frames": frames}  # fmt: skip


@functools.lru_cache(maxsize=4)
def _operator(phantom: str, wire: str) -> Operator:
    from cathsim import load_phantom

    return Operator(load_phantom(phantom), wire)


@functools.lru_cache(maxsize=4)
def _fluoroscope(phantom: str, wire: str, fluid: bool, studio: Studio) -> BiplaneFluoroscope:
    from cathsim.fluoroscopy import BiplaneFluoroscope, radiograph, scene, wire_material
    from pipeline.stages.guide3d.wire_motions import PRESETS

    operator = _operator(phantom, wire)
    anatomy, cameras = operator.phantom, list(cameras_of(studio).values())
    what = scene("bath", studio.filling if fluid else "air")
    stills = [radiograph(anatomy.grid, camera, what, key=anatomy.hash) for camera in cameras]
    material = wire_material(PRESETS[wire], operator.simulation.wire.radius)
    return BiplaneFluoroscope(cameras, stills, material=material, centre=studio.centre)


def assemble(folder: Path, acquisitions: Sequence[Acquisition], studio: Studio) -> Path:
    """Writes annotations, true curves, cameras and properties of a data set whose acquisitions are made.

    Args:
        folder: of the stage.
        acquisitions: all of the data set.
        studio: how they were made.

    Returns:
        The data set's folder.
    """
    root = folder / DATASET
    if (root / PROPERTIES).exists():
        return root
    annotations: list[Annotation] = []
    curves: dict[tuple[str, int], Views] = {}
    truths: dict[tuple[str, int], TrueCurve] = {}
    kinds: dict[str, dict[str, str]] = {}
    for acquisition in acquisitions:
        take = json.loads((folder / TAKES / f"{acquisition.name}.json").read_text(encoding="utf-8"))
        kinds[acquisition.name] = {"phantom": take["phantom"], "motion": take["motion"]}
        for frame in take["frames"]:
            key = acquisition.name, int(frame["number"])
            points = {name: np.array(frame["points"][name]) for name in ("a", "b")}
            images = {name: image_name(key[0], name, key[1]) for name in ("a", "b")}
            annotations.append(
                Annotation(*key, take["fluid"], take["wire"], images["a"], images["b"], points["a"], points["b"])
            )
            curves[key] = Views(*(_fitted(points[name], studio.annotation_noise_px) for name in ("a", "b")))
            visible = tuple(float(frame["visible_mm"][name]) for name in ("a", "b"))
            truths[key] = TrueCurve(np.array(frame["curve_mm"]), (visible[0], visible[1]))
    size = studio.image_size_px
    write_raw(root / RAW, annotations)
    write_curves(root / CURVES, annotations, curves)
    write_cvat(root / "cvat.xml", annotations, {"a": (size, size), "b": (size, size)})
    write_truth(root / TRUTH, truths)
    xray = cameras_of(studio)
    for name, camera in xray.items():
        projector = camera.projector
        write_camera(
            Camera(projector.K, projector.R, _MM * projector.t, size, size, DETECTOR[name]),
            root / "calibration" / f"projection_{DETECTOR[name]}.txt",
        )
        if studio.distorted:
            _map(camera, size).save(root / "calibration" / f"distortion_{DETECTOR[name]}.npz")
    write_json(
        root / PROPERTIES,
        {
            "origin": "cathsim",
            "image_size_px": size,
            "undistorted": not studio.distorted,
            "annotation_noise_px": studio.annotation_noise_px,
            "cameras": {DETECTOR[name]: camera.to_json() for name, camera in xray.items()},
            "acquisitions": kinds,
        },
    )
    return root


def _map(camera: XRayCamera, size: int) -> Distortion:
    """The camera's distortion as a perforated sheet in front of it would show it, without error."""
    pitch, reach = _SHEET_PITCH * size, int(1.2 / _SHEET_PITCH)
    q, r = (index.ravel() for index in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    ideal = pitch * lattice_points(np.column_stack([q, r])) + (size - 1) / 2
    raw = np.full_like(ideal, np.inf)
    near = np.abs(ideal - (size - 1) / 2).max(axis=1) < 0.6 * size
    raw[near] = camera.distortion.distort(ideal[near])
    kept = (np.abs(raw - (size - 1) / 2) <= size / 2 + pitch).all(axis=1)
    return Distortion(raw[kept], ideal[kept], size, size)


def _fitted(points: np.ndarray, noise_px: float) -> BSplineCurve:
    return fit_bspline(points, smoothing=2 * max(noise_px, _SPLINE_PX) ** 2 * len(points))
