"""The bi-planar data set: annotations, curves, truths, cameras and properties that are damaged or say nonsense."""

import json
import random
import shutil
from pathlib import Path

import numpy as np
import pytest

from guide3d.dataset.annotation_files import Annotation
from guide3d.dataset.cvat import read_cvat, write_cvat
from guide3d.dataset.dataset import Dataset
from tests.fuzz.mutations import altered, damaged, rewritten, text_of
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused
from tests.guide3d.dataset.drawn_dataset import SIZE, annotation, wire, write_dataset


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set and an export of CVAT."""
    folder = tmp_path_factory.mktemp("data_sets")
    write_dataset(folder / "whole", acquisitions=2, frames=2, images=False)
    pairs = [annotation("0-bca-angle-1", number, wire(0.1 * number)) for number in range(3)]
    write_cvat(folder / "cvat.xml", pairs, {"a": (SIZE, SIZE), "b": (SIZE, SIZE)})
    return folder


@fuzz(53, 92, 170, 220, 241, 264)
def test_data_sets(rng: random.Random, folder: Path) -> str:
    """A data set opens with finite points and cameras, or is refused."""
    path = folder / "victim"
    shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(folder / "whole", path)
    victim = rng.choice(sorted(file for file in path.rglob("*") if file.is_file()))
    text = victim.read_text()
    kind = rng.randrange(3)
    if kind == 0:
        victim.write_bytes(damaged(victim.read_bytes(), rng))
    elif victim.suffix == ".json":
        victim.write_text(text_of(altered(json.loads(text), rng), rng), "utf-8", "replace")
    else:
        victim.write_text(rewritten(text, rng), "utf-8", "replace")
    try:
        data = Dataset.open(path)
    except (ValueError, FileNotFoundError) as error:
        return refused(error)
    require_usable([frame.annotation for frame in data.frames])
    for camera in (data.camera_a, data.camera_b):
        numbers = () if camera is None else (camera.K, camera.R, camera.t_mm)
        if not all(np.isfinite(part).all() for part in numbers):
            raise BrokenPromiseError("a camera is not finite")
    return "accepted"


@fuzz()
def test_cvat(rng: random.Random, folder: Path) -> str:
    """An export of CVAT has finite points, or is refused."""
    path = folder / "victim.xml"
    text = (folder / "cvat.xml").read_text()
    changed = rewritten(text, rng) if rng.random() < 0.5 else ""
    path.write_bytes(changed.encode("utf-8", "replace") or damaged(text.encode(), rng))
    try:
        annotations = read_cvat(path, [])
    except (ValueError, FileNotFoundError) as error:
        return refused(error)
    require_usable(annotations)
    return "accepted"


def require_usable(annotations: list[Annotation]) -> None:
    """Refuses points that no picture can have."""
    for one in annotations:
        for points in (one.points_a, one.points_b):
            if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
                raise BrokenPromiseError(f"{one.label} has points of shape {points.shape} that are no pixels")
