"""The public data set's annotation files: raw.json with polylines, b_spline.json and sphere.json with curves.

An image is called ``{fluid}-{target}-{angle|straight}-{number}-{camera}/{frame:03d}.png``. Camera 2 is detector 16710,
here camera A; camera 1 is detector 16709, here camera B. The public files disagree about which of them they call the
first: raw.json puts camera 2 under "camera1", b_spline.json camera 1 under "cameraA". So the image's folder decides,
and the key only where the folder says nothing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

from guide3d.files import read_json, whole_file
from guide3d.geometry.bspline import BSplineCurve
from guide3d.geometry.polyline import Array, checked

CAMERA_SUFFIX = {"a": "2", "b": "1"}  # of the image folders
DETECTOR = {"a": "16710", "b": "16709"}
WIRES = ("angled", "straight")
_FOLDER = re.compile(r"(?P<acquisition>.+)-(?P<camera>[12])")
_NAME = re.compile(r"(?P<fluid>[01])-(?P<target>.+)-(?P<wire>angled?|straight)-(?P<number>\d+)")
_KEYS = {"a": ("camera1", "cameraA"), "b": ("camera2", "cameraB")}


@dataclass(frozen=True, eq=False)
class Annotation:
    """Both annotated views of one moment.

    Attributes:
        acquisition: name of the video, e.g. "1-bca-angle-5".
        wire: "angled" or "straight".
        image_a, image_b: paths of the cameras' images below the folder of images.
        points_a, points_b: (n, 2) and (m, 2) px, tip first.
    """

    acquisition: str
    number: int
    fluid: bool
    wire: str
    image_a: str
    image_b: str
    points_a: Array
    points_b: Array

    @property
    def label(self) -> str:
        """The frame's name in messages, e.g. "1-bca-angle-5/012"."""
        return f"{self.acquisition}/{self.number:03d}"


@dataclass(frozen=True, eq=False)
class Views:
    """The fitted curves of one moment: px for the views, mm in space."""

    a: BSplineCurve
    b: BSplineCurve
    space: BSplineCurve | None = None


def acquisition_name(fluid: bool, target: str, wire: str, number: int) -> str:
    """The public name of an acquisition, e.g. "1-bca-angle-5" of the "angled" wire."""
    return f"{int(fluid)}-{target}-{'angle' if wire == 'angled' else wire}-{number}"


def image_name(acquisition: str, camera: str, number: int) -> str:
    """The public name of an image, e.g. "1-bca-angle-5-2/012.png" of camera "a"."""
    return f"{acquisition}-{CAMERA_SUFFIX[camera]}/{number:03d}.png"


def camera_of(image: str) -> str | None:
    """Which camera an image is of, "a" or "b", by its folder's name; None where that does not say."""
    match = _FOLDER.fullmatch(_folder(image))
    return None if match is None else {"2": "a", "1": "b"}[match["camera"]]


def acquisition_of(image: str) -> str:
    """The acquisition of an image: its folder's name without the camera."""
    match = _FOLDER.fullmatch(_folder(image))
    return _folder(image) if match is None else match["acquisition"]


def fluid_and_wire(acquisition: str, video: Mapping[str, Any]) -> tuple[bool, str]:
    """Whether an acquisition is with fluid, and its wire, by its entry or else by its name.

    Args:
        video: its entry, with "fluid" and "guidewire_type" where it has them.

    Raises:
        ValueError: neither says it.
    """
    match = _NAME.fullmatch(acquisition)
    fluid, wire = video.get("fluid"), video.get("guidewire_type")
    if match is not None:
        fluid = int(match["fluid"]) if fluid is None else fluid
        wire = wire or match["wire"]
    wire = {"angle": "angled"}.get(str(wire), wire)
    if fluid is None or wire not in WIRES:
        raise ValueError(
            f'{acquisition}: expected "fluid" and "guidewire_type" (angled or straight) in the entry or in a name like '
            f"1-bca-angle-5, found {fluid!r} and {wire!r}"
        )
    return bool(fluid), str(wire)


def read_raw(path: Path, damaged: list[str]) -> list[Annotation]:
    """Reads the polylines of raw.json: the annotations that can be used, in the file's order.

    Args:
        damaged: takes a sentence for every frame that is left out.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no list of videos with frames.
    """
    annotations = []
    for video, frame, label in _frames(path, damaged):
        try:
            views = _by_camera(frame)
            points = {
                camera: checked(view.get("points", ()), 2, f"annotation of camera {camera.upper()}")
                for camera, view in views.items()
            }
            images = {camera: str(view["image"]) for camera, view in views.items()}
            acquisition = acquisition_of(images["a"])
            if acquisition_of(images["b"]) != acquisition:
                raise ValueError(f"the images are of two acquisitions, {images['a']} and {images['b']}")
            fluid, wire = fluid_and_wire(acquisition, video)
        except (ValueError, TypeError, OverflowError) as error:
            damaged.append(f"{path.name}, {label}: {error}")
            continue
        number = _number(frame, images["a"])
        annotations.append(
            Annotation(acquisition, number, fluid, wire, images["a"], images["b"], points["a"], points["b"])
        )
    return annotations


def read_curves(path: Path, damaged: list[str]) -> dict[tuple[str, int], Views]:
    """Reads the fitted curves of b_spline.json or sphere.json: (acquisition, frame number) to curves.

    Args:
        damaged: takes a sentence for every frame that is left out.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no list of videos with frames.
    """
    curves = {}
    for _, frame, label in _frames(path, damaged):
        try:
            views = _by_camera(frame)
            plane = {camera: BSplineCurve.from_tck(view) for camera, view in views.items()}
            space = BSplineCurve.from_tck(frame["3d"]) if isinstance(frame.get("3d"), Mapping) else None
            for curve, dimension in ((plane["a"], 2), (plane["b"], 2), (space, 3)):
                if curve is not None and curve.coefficients.shape[1] != dimension:
                    raise ValueError(f"expected a curve in {dimension} dimensions, got {curve.coefficients.shape[1]}")
        except (ValueError, TypeError, OverflowError) as error:
            damaged.append(f"{path.name}, {label}: {error}")
            continue
        image = str(views["a"].get("image", ""))
        curves[acquisition_of(image), _number(frame, image)] = Views(plane["a"], plane["b"], space)
    return curves


def write_raw(path: Path, annotations: Sequence[Annotation]) -> None:
    """Writes raw.json; it appears whole or not at all."""

    def view(image: str, points: Array) -> dict[str, Any]:
        return {"image": image, "points": [[round(float(x), 2), round(float(y), 2)] for x, y in points]}

    _write(
        path,
        _videos(annotations, lambda frame: {
            "camera1": view(frame.image_a, frame.points_a),
            "camera2": view(frame.image_b, frame.points_b),
        }),
    )  # fmt: skip


def write_curves(path: Path, annotations: Sequence[Annotation], curves: Mapping[tuple[str, int], Views]) -> None:
    """Writes b_spline.json, or with curves in space what the public data set calls sphere.json.

    Args:
        path: of the file; it appears whole or not at all.
        annotations: whose curves; in the order they are to stand in.
        curves: (acquisition, frame number) to curves; frames without any are left out.
    """

    def entry(frame: Annotation) -> dict[str, Any]:
        views = curves[frame.acquisition, frame.number]
        written: dict[str, Any] = {
            "cameraA": {"image": frame.image_a, **_rounded(views.a, 3)},
            "cameraB": {"image": frame.image_b, **_rounded(views.b, 3)},
        }
        if views.space is not None:
            written["3d"] = _rounded(views.space, 4)
        return written

    frames = [frame for frame in annotations if (frame.acquisition, frame.number) in curves]
    _write(path, _videos(frames, entry))


def _rounded(curve: BSplineCurve, digits: int) -> dict[str, Any]:
    ends = [round(float(end), digits) for end in curve.domain]
    tck = {
        "t": [round(float(knot), digits) for knot in curve.knots],
        "c": [[round(float(value), digits) for value in row] for row in curve.coefficients.T],
        "k": int(curve.degree),
    }
    return {"tck": tck, "u": ends}


def _videos(annotations: Sequence[Annotation], entry: Any) -> list[dict[str, Any]]:
    videos: dict[str, dict[str, Any]] = {}
    for frame in annotations:
        match = _NAME.fullmatch(frame.acquisition)
        video = videos.setdefault(
            frame.acquisition,
            {
                "fluid": frame.fluid,
                "guidewire_type": frame.wire,
                "video_number": int(match["number"]) if match else len(videos),
                "frame_count": 0,
                "task": frame.acquisition,
                "frames": [],
            },
        )
        video["frames"].append({"frame_number": frame.number, **entry(frame)})
        video["frame_count"] += 1
    return list(videos.values())


def _write(path: Path, content: Any) -> None:
    with whole_file(path, "w") as file:
        json.dump(content, file, separators=(",", ":"), allow_nan=False)
        file.write("\n")


def _frames(path: Path, damaged: list[str]) -> Iterator[tuple[Mapping[str, Any], Mapping[str, Any], str]]:
    """Yields video, frame and the frame's label."""
    content = read_json(path, "annotation file")
    if not isinstance(content, list):
        raise ValueError(f"{path}: expected a list of videos, found {type(content).__name__}")
    for place, video in enumerate(content):
        frames = video.get("frames") if isinstance(video, Mapping) else None
        if not isinstance(frames, Iterable) or isinstance(frames, str | Mapping):
            damaged.append(f'{path.name}, video {place}: expected an object with a list "frames"')
            continue
        for index, frame in enumerate(frames):
            name = video.get("task", f"video {video.get('video_number', place)}")
            label = f"{name}, frame {index}"
            if not isinstance(frame, Mapping):
                damaged.append(f"{path.name}, {label}: expected an object, found {type(frame).__name__}")
                continue
            yield video, frame, label


def _by_camera(frame: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    views: dict[str, Mapping[str, Any]] = {}
    for ours, keys in _KEYS.items():
        key = next((key for key in keys if isinstance(frame.get(key), Mapping)), None)
        if key is None:
            raise ValueError(f'expected "{keys[0]}" or "{keys[1]}", found {", ".join(map(repr, frame)) or "nothing"}')
        view = frame[key]
        if not stays_below(str(view.get("image", ""))):
            raise ValueError(f"expected an image below the folder of images, found {str(view['image'])[:80]!r}")
        camera = camera_of(str(view.get("image", ""))) or ours
        if camera in views:
            raise ValueError(f"both images are of camera {camera.upper()}: {view.get('image')}")
        if "image" not in view or not ("points" in view or "tck" in view):
            raise ValueError(f'"{key}" should hold "image" with "points" or "tck", it holds {", ".join(view)}')
        views[camera] = view
    return views


def stays_below(image: str) -> bool:
    """Whether a name stays in the folder that it is looked up in."""
    path = PureWindowsPath(image)  # takes both separators
    return not path.anchor and ".." not in path.parts


def _number(frame: Mapping[str, Any], image: str) -> int:
    number = frame.get("frame_number")
    if isinstance(number, int):
        return number
    digits = re.findall(r"\d+", Path(image).stem)
    return int(digits[-1]) if digits else 0


def _folder(image: str) -> str:
    return Path(image).parent.name
