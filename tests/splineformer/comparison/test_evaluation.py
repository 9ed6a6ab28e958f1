"""Readers compared on the same images: summaries, disturbances that repeat, images that cannot be read, the scale."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from guide3d.dataset.dataset import Dataset
from splineformer.comparison.evaluation import (
    ReadCurve,
    disturbed_image,
    evaluate_readers,
    example_arrays,
    examples_of,
    frame_of,
    mask_reader,
    mm_per_px,
)
from tests.guide3d.learning.drawn_data import draw

ITEMS = [0, 30, 5]  # 24 frames: two images of camera A, one of camera B


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


def true_reader(data: Dataset, items: list[int], moved_px: float):
    """A reader that knows the truth, moved to the right."""
    left = iter(items)

    def read(image: np.ndarray, camera: str) -> ReadCurve:
        frame, own = frame_of(data, next(left))
        assert own == camera
        return ReadCurve(frame.polyline(camera) + np.array([moved_px, 0.0]), discontinuities=2)

    return read


def test_a_curve_that_is_moved_is_off_by_as_much(data: Dataset) -> None:
    readers = {"moved": true_reader(data, ITEMS, 3.0), "blind": lambda image, camera: ReadCurve(None)}
    counted: list[int] = []
    outcome = evaluate_readers(readers, data, ITEMS, "none", progress=lambda number, of: counted.append(of - number))
    moved, blind = outcome["moved"], outcome["blind"]
    assert moved["mean_px"] == pytest.approx([3.0, 0.0])
    assert moved["tip_errors_px"] == pytest.approx([3.0] * 3)
    assert moved["mean_mm"][0] > moved["mean_px"][0]  # a pixel is 1.5 mm in the drawn data
    assert (moved["discontinuities"], moved["read_pct"], moved["n"], moved["images"]) == (2.0, 100.0, 3, [0, 1, 2])
    assert (blind["read_pct"], blind["median_px"], blind["mean_errors_px"]) == (0.0, None, [])
    assert counted == [3, 2, 1]


def test_images_that_cannot_be_read_are_left_out(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(data: Dataset, item: int, kind: str, number: int, seed: int) -> np.ndarray:
        if number == 1:
            raise ValueError("damaged")
        return disturbed_image(data, item, kind, number, seed)

    monkeypatch.setattr("splineformer.comparison.evaluation.disturbed_image", damaged)
    outcome = evaluate_readers({"true": true_reader(data, [0, 5], 0.0)}, data, ITEMS, "none")["true"]
    assert (outcome["n"], outcome["images"]) == (2, [0, 2])


def test_disturbances_repeat_and_differ_from_image_to_image(data: Dataset) -> None:
    one, again = (disturbed_image(data, 3, "noise", 0, 7) for _ in range(2))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, disturbed_image(data, 3, "noise", 1, 7))
    assert not np.array_equal(one, disturbed_image(data, 3, "noise", 0, 8))


def test_masks_are_traced_from_the_tip(data: Dataset) -> None:
    class Segmenter:
        def predict(self, image: np.ndarray) -> np.ndarray:
            return data.frames[0].mask("a", 4.0)

    read = mask_reader(Segmenter(), data, list(data.acquisitions)[:2])  # type: ignore[arg-type]
    points, discontinuities, mask = read(data.frames[0].image("a"), "a")
    assert points is not None
    assert np.linalg.norm(points[0] - data.frames[0].polyline("a")[0]) < 5.0
    assert discontinuities == 0
    assert mask is not None


def test_examples_are_of_the_median_the_hardest_and_a_hidden_wire(data: Dataset) -> None:
    errors = {"mean_errors_px": [5.0, 1.0, 3.0], "images": [0, 1, 2]}
    chosen = examples_of(errors, ITEMS, [9], ["none", "noise", "occlusion"])
    assert chosen == [("none", 2, 5), ("none", 0, 0), ("occlusion", 0, 9)]
    none_found = examples_of({"mean_errors_px": [], "images": []}, ITEMS, [9], ["none", "noise", "low_contrast"])
    assert none_found == [("none", 0, 0), ("low_contrast", 0, 9)]
    arrays = example_arrays(chosen[:1], data, {"blind": lambda image, camera: ReadCurve(None, 0, image)}, {})
    assert set(arrays) == {"kinds", "image0", "true0", "points0_blind", "mask0"}
    assert arrays["points0_blind"].shape == (0, 2)


def test_scale(data: Dataset) -> None:
    frame, camera = data.frames[0], data.camera_a
    assert camera is not None
    assert frame.curve_mm is not None
    pixels = np.linalg.norm(np.diff(camera.project(frame.curve_mm), axis=0), axis=1).sum()
    lengths = np.linalg.norm(np.diff(frame.curve_mm[:, :2], axis=0), axis=1).sum()
    assert mm_per_px(frame, camera) == pytest.approx(lengths / pixels, rel=0.05)
    without = SimpleNamespace(curve_mm=None)
    assert mm_per_px(without, camera) == pytest.approx(1000 / 650)  # type: ignore[arg-type]  # the origin is 1 m away
    assert mm_per_px(frame, None) is None
