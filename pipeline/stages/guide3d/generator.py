"""The generator of Guide3D data sets: simulated wires, their bi-planar images, annotations and true curves."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from guide3d.dataset.acquisition_split import PlannedAcquisition
from guide3d.dataset.annotation_files import DETECTOR, Annotation, Views, image_name, write_curves, write_raw
from guide3d.dataset.cvat import write_cvat
from guide3d.dataset.dataset import CURVES, PROPERTIES, RAW, TRUTH
from guide3d.dataset.true_curves import (
    VIEWS,
    TrueCurve,
    annotate,
    fit_annotation,
    thin_by_turning,
    visible_part,
    write_truth,
)
from guide3d.geometry.camera import Camera, write_camera
from guide3d.geometry.distortion import Distortion
from guide3d.image_file import encode_png
from pipeline.jobs.worker import Report
from pipeline.seeds import acquisition_seed
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.store.atomic_files import read_json, write_json, write_text

if TYPE_CHECKING:
    from cathsim.fluoroscopy import BiplaneFluoroscope, XRayCamera
    from cathsim.planning.scripted_motions import ScriptedOperator

Centre = tuple[float, float, float]  # (3,) m, where the axes of both cameras meet

DATASET, TAKES = "dataset", ".takes"  # the latter until the stage is done
_MM = 1e3
_CURVE_SPACING = 0.25e-3  # m, of the samples that are projected: a little over a pixel
_TRUTH = 5.0, 0.05  # mm and rad between the points of a true curve: chords within 0.01 mm
_TIP_MARGIN_PX = 10.0  # a tip nearer to the border than this is withdrawn


@dataclass(frozen=True)
class GenerationJob:
    """Acquisitions to be made by one process; the axes of both cameras meet in `centre` (3,) m."""

    folder: Path
    acquisitions: tuple[PlannedAcquisition, ...]
    settings: Guide3dSettings
    centre: Centre
    seed: int


def cameras_of(settings: Guide3dSettings, centre: Centre) -> dict[str, XRayCamera]:
    """Cameras "a" and "b" of the public data set's geometry, whose axes meet in a point (3,) m."""
    from cathsim.fluoroscopy import askew_pair

    return askew_pair(centre, settings.image_size_px, distorted=settings.distorted)


def generate(job: GenerationJob, report: Report) -> dict[str, Any]:
    """Makes acquisitions that are not made whole yet; ``pairs`` and, by motion, how often it was filmed."""
    motions = dict[str, int]()
    pairs, total = 0, sum(acquisition.pairs for acquisition in job.acquisitions)
    for acquisition in job.acquisitions:
        record = _take_path(job.folder, acquisition)
        if not record.exists():
            take = _film(acquisition, job, report.part(pairs / total, 1.0))
            write_text(record, json.dumps(take))  # last: what has no record is made again
        motion = read_json(record)["motion"]
        motions[motion] = motions.get(motion, 0) + 1
        pairs += acquisition.pairs
        report(pairs / total, f"{pairs} of {total} pairs")
    return {"pairs": pairs, "motions": motions}


def _take_path(folder: Path, acquisition: PlannedAcquisition) -> Path:
    return folder / TAKES / f"{acquisition.name}.json"


def _film(acquisition: PlannedAcquisition, job: GenerationJob, report: Any) -> dict[str, Any]:
    from cathsim.fluoroscopy.curve import smooth_curve
    from cathsim.planning.scripted_motions import Script

    settings, images = job.settings, job.folder / DATASET / "images"
    cameras, operator = cameras_of(settings, job.centre), _operator(acquisition.phantom, acquisition.wire)
    bounds, grid, size = operator.phantom.bounds, operator.phantom.grid, settings.image_size_px
    margin = np.array([_TIP_MARGIN_PX, size - 1 - _TIP_MARGIN_PX])

    def seen(tip: np.ndarray) -> bool:
        """In both images, and not beyond the open end of a vessel."""
        places = np.array([camera.pixels(tip[None])[0] for camera in cameras.values()])
        inside = (bounds[0] < tip).all() and (tip < bounds[1]).all() and float(grid.sample(tip)) > -1e-3
        return bool(inside and (places > margin[0]).all() and (places < margin[1]).all())

    seed = acquisition_seed(job.seed, acquisition.number)
    script = Script(acquisition.phantom, acquisition.target, acquisition.wire, acquisition.pairs, settings.steps, seed)
    motion, shapes = operator.film(script, seen)
    filling = settings.filling if acquisition.fluid else "air"
    fluoroscope = _fluoroscope(acquisition.phantom, acquisition.wire, filling, size, settings.distorted, job.centre)
    generator = np.random.default_rng((seed, 1_000))
    frames = []
    for number, nodes in enumerate(shapes):
        curve, arc = smooth_curve(nodes, _CURVE_SPACING)
        frame: dict[str, Any] = {"number": number, "visible_mm": {}, "points": {}}
        for name, camera in cameras.items():
            part = visible_part(camera.pixels(curve), arc, size)
            assert part is not None  # the tip is in view
            points = annotate(part.points, settings.annotation_noise_px, size, generator)
            frame["points"][name] = np.round(points, 2).tolist()
            frame["visible_mm"][name] = part.length * _MM
        visible_mask = arc <= max(frame["visible_mm"].values()) / _MM + 2 * _CURVE_SPACING
        frame["curve_mm"] = np.round(thin_by_turning(_MM * curve[visible_mask], *_TRUTH), 4).tolist()
        for name, picture in fluoroscope.render(nodes, seed=int(generator.integers(2**63))).items():
            path = images / image_name(acquisition.name, name, number)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(encode_png(picture.image))
        frames.append(frame)
        report(len(frames) / len(shapes))
    return {"motion": motion, "frames": frames}


@functools.lru_cache(maxsize=4)
def _operator(phantom: str, wire: str) -> ScriptedOperator:
    from cathsim import load_phantom
    from cathsim.planning.scripted_motions import ScriptedOperator

    return ScriptedOperator(load_phantom(phantom), wire)


@functools.lru_cache(maxsize=4)
def _fluoroscope(
    phantom: str, wire: str, filling: str, size: int, distorted: bool, centre: Centre
) -> BiplaneFluoroscope:
    from cathsim.fluoroscopy import BiplaneFluoroscope, askew_pair, radiograph, scene, wire_material
    from cathsim.planning.scripted_motions import WIRES

    operator = _operator(phantom, wire)
    anatomy, cameras = operator.phantom, list(askew_pair(centre, size, distorted=distorted).values())
    what = scene("bath", filling)
    stills = [radiograph(anatomy.grid, camera, what, key=anatomy.hash) for camera in cameras]
    material = wire_material(WIRES[wire], operator.simulation.wire.radius)
    return BiplaneFluoroscope(cameras, stills, material=material, centre=centre)


def assemble(
    folder: Path, acquisitions: Sequence[PlannedAcquisition], settings: Guide3dSettings, centre: Centre
) -> Path:
    """Writes annotations, curves, cameras (axes meet at `centre`, m) and properties of a data set that was made."""
    root = folder / DATASET
    if (root / PROPERTIES).exists():
        return root
    annotations: list[Annotation] = []
    curves: dict[tuple[str, int], Views] = {}
    truths: dict[tuple[str, int], TrueCurve] = {}
    kinds: dict[str, dict[str, str]] = {}
    for acquisition in acquisitions:
        take = read_json(_take_path(folder, acquisition))
        kinds[acquisition.name] = {"phantom": acquisition.phantom, "motion": take["motion"]}
        for frame in take["frames"]:
            key = acquisition.name, int(frame["number"])
            a, b = (np.array(frame["points"][view]) for view in VIEWS)
            images = [image_name(key[0], view, key[1]) for view in VIEWS]
            annotations.append(Annotation(*key, acquisition.fluid, acquisition.wire, images[0], images[1], a, b))
            curves[key] = Views(*(fit_annotation(points, settings.annotation_noise_px) for points in (a, b)))
            truths[key] = TrueCurve(
                np.array(frame["curve_mm"]), (float(frame["visible_mm"]["a"]), float(frame["visible_mm"]["b"]))
            )
    size = settings.image_size_px
    write_raw(root / RAW, annotations)
    write_curves(root / CURVES, annotations, curves)
    write_cvat(root / "cvat.xml", annotations, {"a": (size, size), "b": (size, size)})
    write_truth(root / TRUTH, truths)
    xray = cameras_of(settings, centre)
    for name, camera in xray.items():
        projector, detector = camera.projector, DETECTOR[name]
        write_camera(
            Camera(projector.K, projector.R, _MM * projector.t, size, size, detector),
            root / "calibration" / f"projection_{detector}.txt",
        )
        if settings.distorted:
            distortion = Distortion.of_function(camera.distortion.distort, size)
            distortion.save(root / "calibration" / f"distortion_{detector}.npz")
    write_json(
        root / PROPERTIES,
        {
            "origin": "cathsim",
            "image_size_px": size,
            "undistorted": not settings.distorted,
            "annotation_noise_px": settings.annotation_noise_px,
            "cameras": {DETECTOR[name]: camera.to_json() for name, camera in xray.items()},
            "acquisitions": kinds,
        },
    )
    return root
