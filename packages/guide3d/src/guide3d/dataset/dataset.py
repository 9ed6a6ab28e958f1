"""The Guide3D data set on disk, in the public layout: annotations, images, cameras, and the truth of simulated ones.

A root holds, where it has them::

    raw.json                    polylines; or only an export of CVAT, *.xml
    b_spline.json, sphere.json  fitted curves; "3d" in space, mm
    images/                     {0|1}-{target}-{angle|straight}-{n}-{2|1}/{frame:03d}.png, or these folders themselves
    calibration/                *16710*.txt (camera A), *16709*.txt (camera B), world unit cm; or the same as .yaml;
                                maps of the distortion, *16710*.npz and *16709*.npz
    truth.json                  simulated wires in space
    dataset.json                properties: image size, whether images and annotation are undistorted

Annotation files may also lie in folders below the root, as in the public archive.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from guide3d.calibration.folder import cameras_in, distortions_in
from guide3d.dataset.acquisition_split import Split, split_acquisitions
from guide3d.dataset.annotation_files import Annotation, Views, read_curves, read_raw
from guide3d.dataset.cvat import read_cvat
from guide3d.dataset.frame import Frame
from guide3d.dataset.true_curves import VIEWS, read_truth
from guide3d.files import files_in, read_json
from guide3d.geometry.camera import Camera
from guide3d.geometry.distortion import Distortion

RAW, CURVES, SPACE, TRUTH, PROPERTIES = "raw.json", "b_spline.json", "sphere.json", "truth.json", "dataset.json"
PUBLIC_SIZE_PX = 1024
LARGEST_SIDE_PX = 8192
OUTSIDE_PX = 20.0  # an annotation further outside the image is damaged; nearer it is a click's noise at the border
_NAMED = 5  # damaged entries that the log names one by one

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Annotated bi-planar acquisitions.

    Attributes:
        frames: sorted by acquisition, in time order in each.
        camera_a, camera_b: of detectors 16710 and 16709; None without a calibration.
        undistorted: whether images and annotation are free of the detectors' distortion; None where nobody said.
        distortions: of cameras A and B, where they are known.
        skipped: a sentence for every damaged entry that was left out.
    """

    root: Path
    frames: list[Frame]
    camera_a: Camera | None
    camera_b: Camera | None
    undistorted: bool | None
    distortions: tuple[Distortion, Distortion] | None = None
    skipped: tuple[str, ...] = ()

    @classmethod
    def open(
        cls,
        root: str | Path,
        *,
        images: str | Path | None = None,
        calibration: str | Path | None = None,
        curves: str | Path | None = None,
        undistorted: bool | None = None,
        strict: bool = False,
    ) -> Dataset:
        """Opens a data set; images are only looked for, not read.

        Args:
            root: its folder, or the file raw.json itself.
            images: folder of the images, where they lie elsewhere.
            calibration: folder of the camera files, where they lie elsewhere.
            curves: file of fitted curves, such as sphere.json, where it lies elsewhere.
            undistorted: says whether the annotation is undistorted, instead of dataset.json.
            strict: refuse damaged entries instead of leaving them out.

        Raises:
            FileNotFoundError: there is no such folder, no annotation, or only one camera's file.
            ValueError: a file cannot be understood, no frame can be used, or (strict) an entry is damaged.
        """
        path = Path(root)
        if not path.exists():
            raise FileNotFoundError(f"{path} is missing: expected the folder of a Guide3D data set")
        folder = path if path.is_dir() else path.parent
        damaged: list[str] = []
        properties = _properties(folder)
        own = folder if calibration is None else Path(calibration)
        cameras = cameras_in(own) or (None, None)
        sizes = {view: _size(camera, properties) for view, camera in zip(VIEWS, cameras, strict=True)}
        annotations = _annotations(path, folder, damaged)
        fitted = _curves(folder, None if curves is None else Path(curves), damaged)
        truths = next((read_truth(file, damaged) for file in files_in(folder, TRUTH)), {})
        pictures = Path(images) if images is not None else _image_folder(folder, annotations)
        frames: dict[tuple[str, int], Frame] = {}
        for annotation in annotations:
            key = (annotation.acquisition, annotation.number)
            reason = _outside(annotation, sizes)
            if reason is None and key in frames:
                reason = "it is annotated twice; the first one counts"
            if reason is not None:
                damaged.append(f"{annotation.label}: {reason}")
                continue
            frames[key] = Frame(annotation, pictures, sizes, fitted.get(key), truths.get(key))
        if damaged and strict:
            raise ValueError(f"{folder}: {len(damaged)} damaged entries; the first: {damaged[0]}")
        if not frames:
            first = f"; the first: {damaged[0]}" if damaged else ""
            raise ValueError(f"{folder} holds no frame that can be used{first}")
        for sentence in damaged[:_NAMED]:
            _LOGGER.warning("left out: %s", sentence)
        if len(damaged) > _NAMED:
            _LOGGER.warning("left out: %d more entries", len(damaged) - _NAMED)
        is_undistorted = properties.get("undistorted") if undistorted is None else undistorted
        ordered = [frames[key] for key in sorted(frames)]
        camera_a, camera_b = cameras
        return cls(folder, ordered, camera_a, camera_b, is_undistorted, distortions_in(own), tuple(damaged))

    def __len__(self) -> int:
        return len(self.frames)

    @cached_property
    def acquisitions(self) -> dict[str, list[int]]:
        """Name of an acquisition to the indices of its frames, in time order."""
        lengths: dict[str, list[int]] = {}
        for index, frame in enumerate(self.frames):
            lengths.setdefault(frame.acquisition, []).append(index)
        return lengths

    @property
    def side_px(self) -> int:
        """Side of its square images, px; ValueError where they are not square."""
        width, height = self.frames[0].size_px[VIEWS[0]]
        if width != height:
            raise ValueError(f"{self.root}: expected square images, got {width} x {height} px")
        return width

    def undistort(self, camera: str, points: np.ndarray) -> np.ndarray:
        """Annotated pixels (n, 2) of camera "a" or "b" as a pinhole camera would see them, (n, 2) px.

        They stay where they are where the data set is undistorted or its distortion is not known.
        """
        if self.undistorted is not False or self.distortions is None:
            return points
        return self.distortions[VIEWS.index(camera)].undistort_points(points)

    def distort(self, camera: str, points: np.ndarray) -> np.ndarray:
        """Pixels (n, 2) of a pinhole camera "a" or "b" as the images show them: the inverse of `undistort`."""
        if self.undistorted is not False or self.distortions is None:
            return points
        return self.distortions[VIEWS.index(camera)].distort_points(points)


def split(data: Dataset, shares: tuple[float, float, float] = (0.8, 0.1, 0.1), seed: int = 0) -> Split:
    """Divides a data set by acquisition, stratified by wire and fluid; partners stay together.

    Args:
        shares: of the frames in train, validation and test.
    """
    kinds = {}
    for name, indices in data.acquisitions.items():
        frame = data.frames[indices[0]]
        kinds[name] = (f"{frame.wire}, {'fluid' if frame.fluid else 'dry'}", len(indices))
    return split_acquisitions(kinds, shares, seed)


def samples_of(data: Dataset, split: Split) -> str:
    """A digest of a data set's frames, with their curves in the images, and of the split."""
    digest = hashlib.sha256(repr(split).encode())
    for frame in data.frames:
        digest.update(frame.label.encode())
        for camera in VIEWS:
            digest.update(np.ascontiguousarray(frame.polyline(camera)).tobytes())
    return digest.hexdigest()


def images_of(data: Dataset, acquisitions: Sequence[str], at_most: int = 0) -> NDArray[np.int64]:
    """Lists the images of acquisitions, both cameras; at most some of them, evenly chosen (0: all).

    Returns:
        (n,) indices: camera times the number of frames, plus frame.
    """
    frames = np.array([index for name in acquisitions for index in data.acquisitions[name]], np.int64)
    both = np.stack([frames + camera * len(data.frames) for camera in range(len(VIEWS))], axis=1).reshape(-1)
    if not at_most or len(both) <= at_most:
        return both
    return both[np.linspace(0, len(both) - 1, at_most).round().astype(np.int64)]


def _annotations(path: Path, folder: Path, damaged: list[str]) -> list[Annotation]:
    raw = _find(folder, RAW) if path.is_dir() else path
    if raw is not None:
        return read_raw(raw, damaged)
    export = _find(folder, "*.xml")
    if export is not None:
        return read_cvat(export, damaged)
    raise FileNotFoundError(f"{folder} holds no annotation: expected {RAW} or an export of CVAT (*.xml)")


def _curves(folder: Path, space_file: Path | None, damaged: list[str]) -> dict[tuple[str, int], Views]:
    curves: dict[tuple[str, int], Views] = {}
    for file in (_find(folder, CURVES), space_file or _find(folder, SPACE)):  # the latter also holds curves in space
        if file is not None:
            curves |= read_curves(file, damaged)
    return curves


def _find(folder: Path, name: str) -> Path | None:
    """The file of that name, whatever its capitals, nearest to the folder."""
    pattern = "".join(f"[{letter}{letter.upper()}]" if letter.isalpha() else letter for letter in name)
    files = (file for file in folder.rglob(pattern) if not file.name.startswith("."))
    return min(files, key=lambda file: (len(file.parts), str(file)), default=None)


def _image_folder(folder: Path, annotations: list[Annotation]) -> Path | None:
    """Where the first images that are there lie."""
    places = [folder / "images", folder, *(p for p in sorted(folder.glob("*/")) if p.name != "images")]
    for place in places:
        if any((place / annotation.image_a).is_file() for annotation in annotations[:50]):
            return place
    return None


def _size(camera: Camera | None, properties: Mapping[str, Any]) -> tuple[int, int]:
    if camera is not None:
        return camera.width, camera.height
    side: int = properties.get("image_size_px", PUBLIC_SIZE_PX)
    return side, side


def _outside(annotation: Annotation, sizes: Mapping[str, tuple[int, int]]) -> str | None:
    """Why an annotation does not belong to its image; None where it does."""
    for view, points in zip(VIEWS, (annotation.points_a, annotation.points_b), strict=True):
        size = np.array(sizes[view], float)
        beyond = np.maximum(-points, points - (size - 1)).max(axis=1)
        worst = int(beyond.argmax())
        if beyond[worst] > OUTSIDE_PX:
            x, y = points[worst]
            return (
                f"point {worst} of camera {view.upper()}'s annotation, ({x:.0f}, {y:.0f}), lies {beyond[worst]:.0f} px "
                f"outside the image of {sizes[view][0]} x {sizes[view][1]} px"
            )
    return None


def _properties(folder: Path) -> dict[str, Any]:
    path = next(iter(files_in(folder, PROPERTIES)), None)
    content = {} if path is None else read_json(path, "file")
    if not isinstance(content, dict) or not isinstance(content.get("undistorted"), bool | None):
        raise ValueError(f'{path}: expected an object whose "undistorted", if it is there, is true or false')
    side = content.get("image_size_px", PUBLIC_SIZE_PX)
    if not isinstance(side, int) or not 1 <= side <= LARGEST_SIDE_PX:
        raise ValueError(f'{path}: expected "image_size_px" from 1 to {LARGEST_SIDE_PX}, found {str(side)[:40]}')
    return content
