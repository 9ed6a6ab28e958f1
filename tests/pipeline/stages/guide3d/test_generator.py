"""The generator of bi-planar data sets: a tiny set whose pieces agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guide3d.dataset.acquisition_split import COMPOSITION, plan_acquisitions
from guide3d.dataset.annotation_files import read_curves
from guide3d.dataset.cvat import read_cvat
from guide3d.dataset.dataset import Dataset
from guide3d.geometry.polyline import distances_to
from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.generator import TAKES, GenerationJob, assemble, cameras_of, generate
from pipeline.stages.guide3d.settings import Guide3dSettings

SIZE = 256


SETTINGS = Guide3dSettings(image_size_px=SIZE, distorted=True)
CENTRE = (0.0, 0.0, 0.004)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with an acquisition of each kind."""
    folder = tmp_path_factory.mktemp("stage")
    plan = plan_acquisitions(24, 2, ["type_1"], ["bca"])
    kinds = {(one.fluid, one.wire): one for one in plan}
    chosen = tuple(kinds.values())
    result = generate(GenerationJob(folder, chosen, SETTINGS, CENTRE, 0), Report())
    assert result["pairs"] == sum(one.pairs for one in chosen)
    record = folder / TAKES / f"{chosen[0].name}.json"
    image = next((folder / "dataset" / "images").glob(f"{chosen[0].name}-2/000.png"))
    first = record.read_bytes(), image.read_bytes()
    record.unlink()  # as if killed before the end of this acquisition
    image.write_bytes(b"half")
    generate(GenerationJob(folder, chosen, SETTINGS, CENTRE, 0), Report())
    assert (record.read_bytes(), image.read_bytes()) == first
    assemble(folder, chosen, SETTINGS, CENTRE)
    assert assemble(folder, chosen, SETTINGS, CENTRE) == folder / "dataset"  # done already
    return folder / "dataset"


def test_truth_annotation_and_cameras_agree(made: Path) -> None:
    data = Dataset.open(made, strict=True)
    assert data.undistorted is False
    assert {(frame.fluid, frame.wire) for frame in data.frames} == set(COMPOSITION)
    for frame in data.frames:
        for view, camera in (("a", data.camera_a), ("b", data.camera_b)):
            assert camera is not None
            seen = camera.project(frame.visible_curve_mm(view))
            points = frame.polyline(view)
            assert distances_to(seen, data.undistort(view, points)).max() < 0.1
            assert distances_to(points, data.distort(view, seen)).max() < 0.1
            exact = {one.name: one for one in cameras_of(SETTINGS, CENTRE).values()}[view]
            assert distances_to(points, exact.pixels(1e-3 * frame.visible_curve_mm(view))).max() < 0.1


def test_the_annotation_lies_on_the_dark_wire(made: Path) -> None:
    data = Dataset.open(made)
    darker = []
    for frame in data.frames:
        image = frame.image("a").astype(float)
        points = frame.polyline("a")
        along = np.gradient(points, axis=0)
        across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)

        def grey(at: np.ndarray, image: np.ndarray = image) -> np.ndarray:
            column, row = np.clip(at.round().astype(int), 0, SIZE - 1).T
            return image[row, column]

        beside = (grey(points + 4 * across) + grey(points - 4 * across)) / 2
        darker.append(np.median(beside - grey(points)))
    assert min(darker) > 4


def test_other_files_hold_the_same(made: Path) -> None:
    data = Dataset.open(made)
    exported = {one.label: one for one in read_cvat(made / "cvat.xml", [])}
    curves = read_curves(made / "b_spline.json", [])
    for frame in data.frames:
        assert np.array_equal(exported[frame.label].points_b, frame.polyline("b"))
        fitted = curves[frame.acquisition, frame.number].b.sample(300)
        assert distances_to(frame.polyline("b"), fitted).max() < 2.0  # clicks closer than 2 px are one
