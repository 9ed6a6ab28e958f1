"""From the images of a sheet and a cube to calibrated detectors, without a click.

Distortion maps of the sheets; beads found, undistorted, recognised, numbered; a rig calibrated; then a second look,
with the cameras known, at beads that letters or borders had hidden.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from guide3d.calibration.bead_cube import Attenuation, Beads, attenuation, find_beads, measure_beads
from guide3d.calibration.cube_files import find_files, read_beads, read_grey, read_references
from guide3d.calibration.cube_orientation import candidates, decide
from guide3d.calibration.lattice_camera import CubeLattice, recognise_lattice
from guide3d.calibration.perforated_sheet import SheetHoles, find_holes
from guide3d.calibration.rig import RigCalibration, Sighting, calibrate_rig
from guide3d.calibration.wire_marks import WireMark, find_marks
from guide3d.geometry.camera import Camera, write_camera, write_opencv_yaml
from guide3d.geometry.distortion import Distortion

logger = logging.getLogger(__name__)

_FAR_PX = 3.0  # from where the cameras put a bead, at a second look
_LEAST_SHARE = 0.5  # of a bead in the image and field, to call it visible


@dataclass(frozen=True, eq=False)
class CubeView:
    """One image of the cube, looked through.

    image: (h, w) grey, raw
    numbers: (n,) bead number of each disc, from 0; -1 for clutter
    pixels: (n, 2) undistorted px of the discs, swirl included
    unseen: bead numbers that should be visible and could not be measured
    """

    pose: str
    detector: str
    image: np.ndarray
    light: Attenuation
    beads: Beads
    numbers: np.ndarray
    pixels: np.ndarray
    marks: list[WireMark]
    unseen: np.ndarray


@dataclass(frozen=True, eq=False)
class CubeCalibration:
    """Everything that came of a folder.

    distortions: by detector, the swirl of the calibration included: undistort with these to go with the cameras
    points_mm: (m, 3) the beads
    """

    rig: RigCalibration
    holes: dict[str, SheetHoles]
    distortions: dict[str, Distortion]
    views: dict[tuple[str, str], CubeView]
    points_mm: np.ndarray
    warnings: list[str]

    def write(self, folder: str | Path) -> list[Path]:
        """Write camera_<detector>.txt (XMALab, cm), opencv/camera_<detector>.yaml (mm) and distortion_<detector>.npz.

        Args:
            folder: Where to; made if missing.
        """
        folder = Path(folder)
        written: list[Path] = []
        for detector, camera in self.rig.cameras.items():
            paths = folder / f"camera_{detector}.txt", folder / "opencv" / f"camera_{detector}.yaml"
            write_camera(camera, paths[0])
            write_opencv_yaml(camera, paths[1])
            written += paths
        for detector, distortion in self.distortions.items():
            written.append(folder / f"distortion_{detector}.npz")
            distortion.save(written[-1])
        return written


def calibrate_folder(folder: str | Path, swirl: str = "auto") -> CubeCalibration:
    """Calibrate the detectors whose images lie in a folder.

    Args:
        folder: See `cube_files.find_files` for the names.
        swirl: As in `calibrate_rig`.

    Raises:
        FileNotFoundError: Something needed is missing.
        ValueError: A file is damaged, of another size, or does not show what its name says.
    """
    files = find_files(folder)
    points_mm = read_beads(files.beads)
    marked = read_references(files.references, len(points_mm)) if files.references else {}
    sheets = {detector: read_grey(path) for detector, path in files.sheets.items()}
    images = {key: read_grey(path) for key, path in files.cubes.items()}
    for key, image in images.items():
        expected, shape = sheets[key[1]].shape, image.shape
        if shape != expected:
            raise ValueError(
                f"{files.cubes[key]}: expected an image of {expected[1]} x {expected[0]} px, as the sheet's, "
                f"found {shape[1]} x {shape[0]}"
            )
    holes = {}
    for detector, sheet in sheets.items():
        logger.info("%s: the sheet's holes", files.sheets[detector])
        try:
            holes[detector] = find_holes(sheet)
        except ValueError as error:
            raise ValueError(f"{files.sheets[detector]}: {error}") from None
    names = {key: str(path) for key, path in files.cubes.items()}
    return calibrate_cube(holes, images, points_mm, marked, swirl, names)


def calibrate_cube(
    holes: dict[str, SheetHoles],
    images: dict[tuple[str, str], np.ndarray],
    points_mm: np.ndarray,
    marked: dict[str, int] | None = None,
    swirl: str = "auto",
    names: dict[tuple[str, str], str] | None = None,
) -> CubeCalibration:
    """Calibrate detectors from images in memory.

    Args:
        images: (h, w) grey, raw, by (pose, detector); the first pose gives the world.
        points_mm: (m, 3) beads in the cube's frame, mm, on a lattice.
        marked: Bead number from 0 of each kind of mark.
        swirl: As in `calibrate_rig`.
        names: What to call the images in errors.

    Raises:
        ValueError: An image shows fewer than twelve beads, or no cube.
    """
    marked, names = marked or {}, names or {key: "_".join(key) for key in images}
    lattice = CubeLattice.of(points_mm)
    distortions = {detector: Distortion.from_holes(sheet) for detector, sheet in holes.items()}
    poses: dict[str, dict] = {}
    detections: dict[tuple[str, str], tuple[Attenuation, Beads, list[WireMark]]] = {}
    for (pose, detector), image in images.items():
        distortion = distortions[detector]
        logger.info("%s: beads and marks", names[pose, detector])
        try:
            light = attenuation(image)
            beads = find_beads(light)
            pixels = distortion.undistort_points(beads.centres_px)
            field = distortion.undistort_image(light.field.astype(np.uint8)) > 0
            fit = recognise_lattice(lattice, pixels, distortion.width, distortion.height, field)
        except ValueError as error:
            raise ValueError(f"{names[pose, detector]}: {error}") from None
        marks = find_marks(light, beads)
        detections[pose, detector] = light, beads, marks
        seen = [replace(mark, pixels=distortion.undistort_points(mark.pixels)) for mark in marks]
        poses.setdefault(pose, {})[detector] = (candidates(lattice, fit, field), seen, field)
    chosen, certain = decide(lattice, list(poses.values()), marked)
    warnings = _attitude_warnings(list(poses), certain, marked)
    views = {}
    for (pose, options), choice in zip(poses.items(), chosen, strict=True):
        for detector, (alternatives, _, _) in options.items():
            light, beads, marks = detections[pose, detector]
            pixels = distortions[detector].undistort_points(beads.centres_px)
            numbers = alternatives[choice[detector]].numbers
            views[pose, detector] = CubeView(
                pose, detector, images[pose, detector], light, beads, numbers, pixels, marks, np.empty(0, int)
            )
    sizes = {detector: (d.width, d.height) for detector, d in distortions.items()}
    logger.info("cameras of %d poses", len(poses))
    rig = calibrate_rig(lattice.points_mm, _sightings(views.values()), sizes, swirl)
    swirled = _swirled(distortions, rig)
    views = {
        key: _second_look(view, rig, swirled[view.detector], lattice.points_mm) if key in rig.used else view
        for key, view in views.items()
    }
    views = _undistorted(views, distortions)  # without the swirl, which the rig estimates once more
    rig = calibrate_rig(lattice.points_mm, _sightings(views.values()), sizes, swirl)
    warnings += [f"pose {pose}: left out, it {why}" for pose, why in rig.left_out.items()]
    distortions = _swirled(distortions, rig)
    return CubeCalibration(rig, dict(holes), distortions, _undistorted(views, distortions), lattice.points_mm, warnings)


def _swirled(distortions: dict[str, Distortion], rig: RigCalibration) -> dict[str, Distortion]:
    return distortions | {detector: distortions[detector].swirled(shift) for detector, shift in rig.swirl_px.items()}


def _undistorted(
    views: dict[tuple[str, str], CubeView], distortions: dict[str, Distortion]
) -> dict[tuple[str, str], CubeView]:
    """The views, their discs undistorted by these maps."""
    return {
        key: replace(view, pixels=distortions[view.detector].undistort_points(view.beads.centres_px))
        for key, view in views.items()
    }


def _attitude_warnings(poses: Sequence[str], certain: Sequence[bool], marked: dict[str, int]) -> list[str]:
    if all(certain):
        return []
    which = ", ".join(pose for pose, sure in zip(poses, certain, strict=True) if not sure)
    why = "its marks are not seen well enough" if marked else "no file names its marked beads"
    return [
        f"pose {which}: the attitude of the cube is one of several that fit ({why}); the world's axes are arbitrary"
    ]


def _sightings(views: Iterable[CubeView]) -> list[Sighting]:
    on = ((view, view.numbers >= 0) for view in views)
    return [Sighting(view.pose, view.detector, view.numbers[mask], view.pixels[mask]) for view, mask in on]


def _second_look(view: CubeView, rig: RigCalibration, distortion: Distortion, points_mm: np.ndarray) -> CubeView:
    """Measure again, with their size known, beads that were missed, doubtful or misplaced."""
    camera = rig.cameras[view.detector]
    Q, s = rig.poses[view.pose]
    world = points_mm @ Q.T + s
    places = distortion.distort_points(camera.project(world))
    magnification = 1 / camera.depth_mm(world)
    on = np.flatnonzero(view.numbers >= 0)
    size = view.beads.radii_px[on].mean(axis=1)
    clean = view.beads.misfit[on] < 0.04
    if clean.sum() < 6:
        return view
    per = float(np.median(size[clean] / magnification[view.numbers[on][clean]]))
    radii = per * magnification
    expected = radii[view.numbers[on]]
    off = np.linalg.norm(view.beads.centres_px[on] - places[view.numbers[on]], axis=1)
    long = view.beads.radii_px[on, 0] / expected
    doubtful = (view.beads.misfit[on] > 0.06) | (long > 1.35) | (off > _FAR_PX)
    missed = np.setdiff1d(np.arange(len(points_mm)), view.numbers[on])
    visible = _visible(view.light.field, places, radii) >= _LEAST_SHARE
    hidden = missed[visible[missed]]
    if len(hidden):  # what touches a bead that was not found is measured again with it
        apart = np.linalg.norm(places[view.numbers[on]][:, None] - places[hidden], axis=2)
        doubtful |= (apart < (expected[:, None] + radii[hidden]) * 1.1).any(axis=1)
    again = np.concatenate([view.numbers[on][doubtful], hidden])
    measured = measure_beads(view.light, places[again], radii[again], _local_shapes(distortion, camera, world[again]))
    near = np.linalg.norm(measured.centres_px - places[again], axis=1) < _FAR_PX
    typical = float(np.median(view.beads.contrast[on]))
    good = near & (measured.misfit < 0.2) & (measured.contrast > 0.5 * typical) & (measured.share >= _LEAST_SHARE)
    clutter = np.flatnonzero(view.numbers < 0)
    rest = np.concatenate([on[~doubtful], clutter])
    beads = view.beads[rest].joined(measured[good])
    numbers = np.concatenate([view.numbers[rest], again[good]])
    logger.debug("%s_%s: %d looked at again, %d measured", view.pose, view.detector, len(again), good.sum())
    pixels = distortion.undistort_points(beads.centres_px)
    return replace(view, beads=beads, numbers=numbers, pixels=pixels, unseen=np.sort(again[~good]))


def _local_shapes(distortion: Distortion, camera: Camera, points_mm: np.ndarray) -> np.ndarray:
    """What the detector makes of small circles at points: matrices (n, 2, 2), raw px per undistorted px."""
    pixels = camera.project(points_mm)
    steps = np.array([[2.0, 0.0], [0.0, 2.0]])
    ahead, back = (distortion.distort_points(pixels[:, None] + sign * steps) for sign in (1, -1))
    J = (ahead - back).transpose(0, 2, 1) / 4
    # the sizes of the beads come from the raw image: keep the form only
    return J / np.sqrt(np.abs(np.linalg.det(J)))[:, None, None]


def _visible(field: np.ndarray, places: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Share (n,) of each disc that lies in the image and its lit field."""
    angle, ring = np.meshgrid(np.linspace(0, 2 * np.pi, 24, endpoint=False), np.sqrt((np.arange(5) + 0.5) / 5))
    dots = np.stack([ring * np.cos(angle), ring * np.sin(angle)], axis=-1).reshape(-1, 2)
    x, y = np.rint(places[:, None] + radii[:, None, None] * dots).astype(int).transpose(2, 0, 1)
    inside = (x >= 0) & (y >= 0) & (x < field.shape[1]) & (y < field.shape[0])
    lit = field[np.clip(y, 0, field.shape[0] - 1), np.clip(x, 0, field.shape[1] - 1)]
    return (inside & lit).mean(axis=1)
