"""Command line: images of random fluoroscopy along the annotated wires of a data set, for any training on it.

::

    python -m guide3d.random_fluoroscopy DATASET --output FOLDER
    python -m guide3d.train DATASET --images FOLDER --network unet --output NETWORK

The folder gets one image for each of the data set's, under its name; annotation and cameras stay valid. The same
command goes on after an interruption; images of another seed or other settings are not mixed with those of a folder,
whose `fluoroscopy.json` says what it holds.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from guide3d.commands import in_words, run
from guide3d.dataset.dataset import Dataset
from guide3d.files import json_fields, read_json, whole_file
from guide3d.image_file import write_image
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.setting_kinds import seed

RECORD = "fluoroscopy.json"  # in the folder of the images
_REPORT_EVERY_S = 10.0
_VIEWS = ("a", "b")
# one wire, as annotated, and no edge of the field that hides a part of it
_AS_ANNOTATED = FluoroscopySettings(no_wire=0.0, two_devices=0.0, field=0.0)


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    about = (__doc__ or "").split("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m guide3d.random_fluoroscopy", description=about)
    parser.add_argument("data", type=Path, help="folder of the data set")
    parser.add_argument("--output", type=Path, required=True, help="folder of the images")
    parser.add_argument("--frames", type=int, help="at most so many, evenly chosen; others get no image")
    parser.add_argument("--settings", type=json_fields, default={}, help="JSON: fields of FluoroscopySettings")
    parser.add_argument("--seed", type=seed, default=0)
    return parser.parse_args(words)


def draw(given: argparse.Namespace) -> int:
    """Draws what the command line asks for; returns the number of images in the folder."""
    data = Dataset.open(given.data)
    known = [field.name for field in fields(FluoroscopySettings)]
    unknown = [name for name in given.settings if name not in known]
    if unknown:
        raise ValueError(f"--settings: {unknown[0]!r} is unknown: expected fields among {', '.join(known)}")
    fluoroscopy = RandomFluoroscopy(replace(_AS_ANNOTATED, **given.settings), given.seed)
    scale = fluoroscopy.settings.image_px / data.side_px
    count = len(data.frames) if given.frames is None else min(given.frames, len(data.frames))
    places = np.linspace(0, len(data.frames) - 1, count).round().astype(int).tolist()
    images = [_image(data, place, camera, given.output) for place in places for camera in _VIEWS]
    content = {"seed": given.seed, "side_px": data.side_px, "settings": asdict(fluoroscopy.settings)}
    _claim(given.output, content, images)
    written, report_time = 0, time.monotonic()
    for place in places:
        frame = data.frames[place]
        for number, camera in enumerate(_VIEWS):
            path = _image(data, place, camera, given.output)
            if not path.is_file():
                drawn = fluoroscopy.along(2 * place + number, [(frame.polyline(camera) + 0.5) * scale - 0.5])
                image = cv2.resize(drawn.image, (data.side_px, data.side_px), interpolation=cv2.INTER_AREA)
                write_image(image, path)
            written += 1
        if time.monotonic() - report_time > _REPORT_EVERY_S:
            report_time = time.monotonic()
            print(f"{written} of {len(_VIEWS) * count} images", file=sys.stderr)
    return written


def _image(data: Dataset, place: int, camera: str, folder: Path) -> Path:
    annotation = data.frames[place].annotation
    return folder / (annotation.image_a if camera == "a" else annotation.image_b)


def _claim(folder: Path, content: dict[str, object], images: list[Path]) -> None:
    """Writes what a folder holds; refuses one that holds images of another content."""
    path = folder / RECORD
    text = json.dumps(content, indent=1)
    if path.is_file():
        if read_json(path, "record") != json.loads(text):
            raise ValueError(f"{folder} holds images of another seed, size or other settings: give another folder")
        return
    other = next((image for image in images if image.exists()), None)
    if other is not None:
        raise ValueError(f"{other} is there, and not of random fluoroscopy: give another folder")
    with whole_file(path, "w") as file:
        file.write(text)


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code, 2 where it was refused."""
    options = arguments(sys.argv[1:] if words is None else words)
    try:
        print(f"{draw(options)} images in {options.output}")
    except (ValueError, OSError) as error:
        print(in_words(error), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    run(main)
