"""Command line: images of random fluoroscopy along the annotated wires of a data set, for any training on it.

::

    python -m guide3d.random_fluoroscopy DATASET --output FOLDER
    python -m guide3d.train DATASET --images FOLDER --network unet --output NETWORK

The folder gets one image for each of the data set's, under its name; annotation and cameras stay valid. The same
command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from guide3d.atomic_file import whole_file
from guide3d.dataset.dataset import Dataset
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.setting_kinds import seed

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
    parser.add_argument("--settings", type=json.loads, default={}, help="JSON: fields of FluoroscopySettings")
    parser.add_argument("--seed", type=seed, default=0)
    return parser.parse_args(words)


def draw(given: argparse.Namespace) -> int:
    """Draws what the command line asks for; returns the number of images in the folder."""
    data = Dataset.open(given.data)
    if not isinstance(given.settings, dict):
        raise ValueError(f"--settings: expected a JSON object of fields, got {given.settings!r}")
    fluoroscopy = RandomFluoroscopy(replace(_AS_ANNOTATED, **given.settings), given.seed)
    scale = fluoroscopy.settings.image_px / data.side_px
    count = len(data.frames) if given.frames is None else min(given.frames, len(data.frames))
    written = 0
    for place in np.linspace(0, len(data.frames) - 1, count).round().astype(int).tolist():
        frame = data.frames[place]
        for number, camera in enumerate(_VIEWS):
            name = frame.annotation.image_a if camera == "a" else frame.annotation.image_b
            path = given.output / name
            if not path.is_file():
                drawn = fluoroscopy.along(2 * place + number, [(frame.polyline(camera) + 0.5) * scale - 0.5])
                image = cv2.resize(drawn.image, (data.side_px, data.side_px), interpolation=cv2.INTER_AREA)
                _, code = cv2.imencode(path.suffix or ".png", image)
                with whole_file(path) as file:
                    file.write(code.tobytes())
            written += 1
    return written


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code, 2 where it was refused."""
    given = arguments(sys.argv[1:] if words is None else words)
    try:
        print(f"{draw(given)} images in {given.output}")
    except (ValueError, TypeError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
