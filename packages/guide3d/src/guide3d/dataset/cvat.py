"""CVAT's XML for images: the polylines of the wire, as the annotators left them."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path

from guide3d.dataset.annotation_files import Annotation, acquisition_of, camera_of, fluid_and_wire, stays_below
from guide3d.files import whole_file
from guide3d.geometry.polyline import Array, checked
from guide3d.guarded_reading import open_regular

LABEL = "guidewire"
_LARGEST = 256 << 20  # bytes


def read_cvat(path: Path, damaged: list[str]) -> list[Annotation]:
    """Reads the pairs of an export: the first polyline of every image; images without their partner are left out.

    Args:
        damaged: takes a sentence for every image that is left out.

    Returns:
        The annotations, in the order of camera A's images.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no XML.
    """
    if not path.exists():
        raise FileNotFoundError(f"annotation file {path} is missing")
    try:
        with open_regular(path, _LARGEST) as file:
            root = ElementTree.parse(file).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: expected CVAT's XML, but it cannot be read ({error})") from None
    labelled = any(line.get("label") == LABEL for line in root.iter("polyline"))  # or the file has no labels like ours
    views: dict[str, dict[tuple[str, str], tuple[str, Array]]] = {"a": {}, "b": {}}
    for image in root.iter("image"):
        name = image.get("name", "")
        try:
            camera = camera_of(name)
            if not stays_below(name):
                raise ValueError("expected an image below the folder of images")
            if camera is None:
                raise ValueError("expected a folder ending in -1 or -2, the camera")
            lines = [one for one in image.findall("polyline") if not labelled or one.get("label") == LABEL]
            if not lines:
                raise ValueError(f"it has no polyline{f' with the label {LABEL}' if labelled else ''}")
            line = lines[0]
            points = [[float(value) for value in point.split(",")] for point in line.get("points", "").split(";")]
            views[camera][acquisition_of(name), Path(name).stem] = name, checked(points, 2, "polyline")
        except ValueError as error:
            damaged.append(f"{path.name}, {name or 'an image without a name'}: {error}")
    annotations: list[Annotation] = []
    for key, (image_a, points_a) in views["a"].items():
        if key not in views["b"]:
            damaged.append(f"{path.name}, {image_a}: camera B has no annotation of this moment")
            continue
        image_b, points_b = views["b"][key]
        try:
            fluid, wire = fluid_and_wire(key[0], {})
        except ValueError as error:
            damaged.append(f"{path.name}, {error}")
            continue
        number = int(key[1]) if key[1].isdecimal() and len(key[1]) < 10 else len(annotations)
        annotations.append(Annotation(key[0], number, fluid, wire, image_a, image_b, points_a, points_b))
    for key in views["b"].keys() - views["a"].keys():
        damaged.append(f"{path.name}, {views['b'][key][0]}: camera A has no annotation of this moment")
    return annotations


def write_cvat(path: Path, annotations: Sequence[Annotation], size_px: Mapping[str, tuple[int, int]]) -> None:
    """Writes an export that CVAT imports ("CVAT for images 1.1").

    Args:
        path: of the file; it appears whole or not at all.
        size_px: camera "a" and "b" to width and height of its images.
    """
    root = ElementTree.Element("annotations")
    ElementTree.SubElement(root, "version").text = "1.1"
    for camera in ("a", "b"):
        width, height = size_px[camera]
        for frame in annotations:
            name, points = (
                (frame.image_a, frame.points_a) if camera == "a" else (frame.image_b, frame.points_b)
            )  # fmt: skip
            image = ElementTree.SubElement(
                root, "image", id=str(len(root) - 1), name=name, width=str(width), height=str(height)
            )
            text = ";".join(f"{x:.2f},{y:.2f}" for x, y in points)
            ElementTree.SubElement(image, "polyline", label=LABEL, source="manual", occluded="0", points=text)
    ElementTree.indent(root)
    with whole_file(path, "wb") as file:
        ElementTree.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)
