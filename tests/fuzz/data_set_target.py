"""The bi-planar data set: annotations, curves, truths, cameras and properties that are damaged or say nonsense."""

from __future__ import annotations

import json
import logging
import random
import shutil
from pathlib import Path

import numpy as np

from guide3d.dataset.annotation_files import Annotation
from guide3d.dataset.cvat import read_cvat, write_cvat
from guide3d.dataset.dataset import Dataset
from tests.fuzz.mutations import altered, damaged, rewritten, text_of
from tests.fuzz.target import Target, WrongError, refused
from tests.guide3d.dataset.drawn_dataset import SIZE, annotation, wire, write_dataset


class DataSetTarget(Target):
    """A data set opens with finite points and cameras, or is refused."""

    name = "data_sets"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        logging.getLogger("guide3d").setLevel(logging.ERROR)
        self.whole = folder / "whole"
        write_dataset(self.whole, acquisitions=2, frames=2, images=False)
        self.cvat = folder / "cvat.xml"
        pairs = [annotation("0-bca-angle-1", number, wire(0.1 * number)) for number in range(3)]
        write_cvat(self.cvat, pairs, {"a": (SIZE, SIZE), "b": (SIZE, SIZE)})

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        if rng.random() < 0.2:
            self._run_cvat(rng)
            return
        path = self.folder / "victim"
        shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(self.whole, path)
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
            require_usable([frame.annotation for frame in data.frames])
            for camera in (data.camera_a, data.camera_b):
                numbers = () if camera is None else (camera.K, camera.R, camera.t_mm)
                if not all(np.isfinite(part).all() for part in numbers):
                    raise WrongError("a camera is not finite")
        except (ValueError, FileNotFoundError) as error:
            self.counts[refused(error)] += 1
        else:
            self.counts["accepted"] += 1

    def _run_cvat(self, rng: random.Random) -> None:
        path = self.folder / "victim.xml"
        text = self.cvat.read_text()
        changed = rewritten(text, rng) if rng.random() < 0.5 else ""
        path.write_bytes(changed.encode("utf-8", "replace") or damaged(self.cvat.read_bytes(), rng))
        try:
            require_usable(read_cvat(path, []))
        except (ValueError, FileNotFoundError) as error:
            self.counts[refused(error)] += 1
        else:
            self.counts["accepted"] += 1


def require_usable(annotations: list[Annotation]) -> None:
    """Refuses points that no picture can have."""
    for one in annotations:
        for points in (one.points_a, one.points_b):
            if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
                raise WrongError(f"{one.label} has points of shape {points.shape} that are no pixels")
