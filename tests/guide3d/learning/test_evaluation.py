"""Evaluation of networks on unseen acquisitions: known errors of known predictions."""

from typing import Any, ClassVar

import numpy as np
import pytest

from guide3d.dataset.dataset import Dataset
from guide3d.learning.evaluation import evaluate_segmentation, evaluate_shape
from guide3d.learning.picture_store import Preprocessing
from tests.guide3d.learning.drawn_data import SIDE, draw


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


class _TrueShape:
    """Predicts the true curves of an acquisition in its order, moved along x."""

    preprocessing = Preprocessing(32, SIDE)
    network = type("Network", (), {"frames": 1})
    metadata: ClassVar[dict[str, Any]] = {}

    def __init__(self, curves: list[np.ndarray]) -> None:
        self.curves = curves

    def predict_pictures(self, windows: np.ndarray) -> list[np.ndarray]:
        assert len(windows) == len(self.curves)
        return self.curves

    def predict(self, images: list[np.ndarray]) -> np.ndarray:
        assert images[0].shape == (SIDE, SIDE)
        return self.curves[0]


class _TrueMask:
    """Predicts the true masks of images in the order in which they are asked for, or their opposite."""

    metadata: ClassVar[dict[str, Any]] = {"mask_px": 4.0}
    preprocessing = Preprocessing(SIDE, SIDE)

    def __init__(self, data: Dataset, wrong: bool) -> None:
        self.data, self.wrong = data, wrong

    def chances(self, picture: np.ndarray) -> np.ndarray:
        own = next(f.mask(v, 4.0) for f in self.data.frames for v in "ab" if np.array_equal(f.image(v), picture)) > 0
        return (own != self.wrong).astype(np.float32)

    def enlarged(self, chances: np.ndarray) -> np.ndarray:
        return chances

    def predict(self, image: np.ndarray) -> np.ndarray:
        return 255 * self.chances(image).astype(np.uint8)


def test_shapes_that_are_moved_are_off_by_as_much(data: Dataset) -> None:
    name = next(iter(data.acquisitions))
    curves = [data.frames[index].curve_mm for index in data.acquisitions[name]]
    figures, examples = evaluate_shape(_TrueShape([c + np.array([2.0, 0.0, 0.0]) for c in curves]), data, [name])  # type: ignore[arg-type]
    assert figures["frames"] == len(curves)
    for metric in ("max_ed", "mers", "frechet"):
        assert figures[metric] == pytest.approx([2.0, 0.0], abs=1e-6)
    assert figures["length_error_mm"][0] == pytest.approx(0.0, abs=1e-9)
    assert figures["along_error_mm"] == pytest.approx([2.0] * len(figures["along_mm"]), abs=1e-6)
    assert figures["reprojection_px"][0] > 0.2
    assert set(examples) == {"frames"} | {f"{what}{k}" for what in ("predicted", "true") for k in range(3)}
    assert set(examples["frames"]) <= set(data.acquisitions[name])


def test_masks_that_are_right_and_wrong(data: Dataset) -> None:
    name = next(iter(data.acquisitions))
    calls: list[tuple[int, int]] = []
    right, examples = evaluate_segmentation(
        _TrueMask(data, False),
        data,
        [name],
        images=3,
        progress=lambda *call: calls.append(call),  # type: ignore[arg-type]
    )
    assert right["images"] == 3
    assert calls == [(0, 3), (1, 3), (2, 3)]
    assert right["dice"] == right["miou"] == [100.0, 0.0]
    assert list(right["by_kind"].values()) == [[100.0, 0.0]]
    assert np.array_equal(examples["true1"] > 0, examples["predicted1"] > 0)
    wrong, _ = evaluate_segmentation(_TrueMask(data, True), data, [name], images=3)  # type: ignore[arg-type]
    assert wrong["dice"] == wrong["miou"] == [0.0, 0.0]
