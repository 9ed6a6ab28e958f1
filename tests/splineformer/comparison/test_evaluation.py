"""Comparison of networks: errors of moved curves, disturbances, traced masks."""

from typing import Any

import numpy as np
import pytest

from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import strip_mask
from guide3d.geometry.polyline import Array
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.build import VARIANTS
from splineformer.comparison.evaluation import (
    BARS,
    DETECTOR_SD,
    GAIN,
    NOISE_SD,
    ReadCurve,
    curve_errors,
    disturbed,
    disturbed_image,
    evaluate_readers,
    example_arrays,
    examples_of,
    frame_of,
    mask_reader,
)
from splineformer.comparison.fluoroscopy_figures import (
    curve_figures,
    figures_of,
    kind_accuracy,
    round_trips,
    speed,
    summary,
)
from splineformer.comparison.skeleton import trace_mask
from splineformer.image_input import pixels_of_shares
from splineformer.learning.fluoroscopy_samples import ONE, curve_of
from splineformer.predictor import Predictor
from tests.guide3d.learning.drawn_data import draw
from tests.splineformer.curves import answering, image_of, network, wavy_wire

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


def test_masks_are_traced_from_the_tip(data: Dataset) -> None:
    class Segmenter:
        def predict(self, image: np.ndarray) -> np.ndarray:
            return data.frames[0].mask("a", 4.0)

    read = mask_reader(Segmenter(), data, list(data.acquisitions)[:2])  # type: ignore[arg-type]
    points, discontinuities, mask = read(data.frames[0].image("a"), "a")
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


WIRE = wavy_wire(0, 1024)
IMAGE = image_of(WIRE, 1024)


def result(kind: str, seed: int = 0) -> np.ndarray:
    return disturbed(kind, IMAGE, WIRE, np.random.default_rng(seed))


def test_what_each_does() -> None:
    change = result("noise").astype(float) - IMAGE
    assert change.std() == pytest.approx(NOISE_SD, rel=0.05)
    assert result("low_contrast").std() == pytest.approx(np.hypot(GAIN * IMAGE.std(), DETECTOR_SD), rel=0.02)
    hidden = result("occlusion") != IMAGE
    assert 0.001 < hidden.mean() < BARS * (72 / 1024) ** 2
    column, row = WIRE.round().astype(int).T
    on_wire = hidden[row.clip(0, 1023), column.clip(0, 1023)]
    assert on_wire.any()
    assert not on_wire[[0, -1]].any()  # tip and end stay in sight
    with pytest.raises(ValueError, match="unknown disturbance 'blur'"):
        result("blur")


SIDE = 300


def test_masks_are_traced_tip_first_and_gaps_counted_and_joined() -> None:
    for seed, gap in ((1, False), (2, True)):
        true = wavy_wire(seed, SIDE)
        mask = strip_mask(true, SIDE, SIDE, 6.0)
        if gap:
            mask[:, 60:85] = 0
        traced = trace_mask(mask, true[-1])
        assert traced.discontinuities == int(gap)
        errors = curve_errors(traced.points_px, true)
        assert errors["mean_px"] < (5 if gap else 2.5)
        assert gap or (traced.pieces == 1 and errors["tip_px"] < 6.0)  # thinning eats half of the width at each end
    assert trace_mask(np.zeros((50, 60)), [0, 0]).points_px is None
    with pytest.raises(ValueError, match=r"expected \(h, w\)"):
        trace_mask(np.zeros((2, 3, 4)), [0, 0])


def test_errors_of_known_curves() -> None:
    line = np.column_stack([np.linspace(0, 100, 20), np.zeros(20)])
    assert curve_errors(line, line + np.array([0, 3])) == pytest.approx(
        {"tip_px": 3, "mean_px": 3, "max_px": 3, "chamfer_px": 3}, abs=1e-9
    )
    backwards = curve_errors(line[::-1], line)
    assert backwards["tip_px"] == pytest.approx(100)
    assert backwards["chamfer_px"] == pytest.approx(0, abs=1e-9)
    half = curve_errors(line[:10], line)
    assert half["max_px"] == pytest.approx(100 - line[9, 0], abs=1e-6)
    with pytest.raises(ValueError, match="predicted curve"):
        curve_errors(line[:1], line)


def predictor() -> Predictor:
    return Predictor(network("ordered"), source_px=128)


@pytest.mark.parametrize("variant", VARIANTS)
def test_curves_survive_as_tokens(variant: str) -> None:
    model = network(variant)
    curves = [wavy_wire(seed, 1024) for seed in range(4)]
    trips = round_trips(model.fit_tokens, curves)
    assert 0 < trips["round_trip_px"] <= trips["round_trip_max_px"] < 20
    assert trips["tokens_max"] <= model.limit
    one_off = round_trips(lambda points: model.fit_tokens(points) + np.array([0.0, 40.0, 0.0]), curves)
    assert one_off["round_trip_px"] > 10 * trips["round_trip_px"]


def test_what_a_network_that_always_says_the_same_recognises(data: Dataset) -> None:
    nothing = {"one": 0.0, "none": 0.0, "several": 0.0, "inverted": 0.0}
    assert kind_accuracy(answering(predictor(), 0), data, [0, 30]) == nothing | {"none": 100.0}
    assert kind_accuracy(answering(predictor(), 1, inverted=True), data, [0, 30]) == nothing | {"inverted": 100.0}


def test_speed_counts_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = predictor()
    batches: list[int] = []
    read = reader.batch
    monkeypatch.setattr(reader, "batch", lambda images: batches.append(len(images)) or read(images))
    figures = speed(reader, image_of(wavy_wire(0, 128), 128), calls=2)
    assert batches == [1, 1, 1, 8, 8, 8]
    assert figures["latency_ms"] > 0
    assert np.isfinite(figures["images_per_s"])


def test_a_curve_in_the_wrong_order_is_far_off() -> None:
    wire = wavy_wire(0)
    exact = curve_figures(wire, wire)
    assert max(exact.values()) < 0.1
    turned = curve_figures(wire[::-1], wire)
    assert turned["curve_px"] < 0.1
    assert turned["order_px"] > 20
    assert turned["tip_px"] == pytest.approx(np.hypot(*(wire[0] - wire[-1])))
    beside = curve_figures(wire + np.array([0.0, 3.0]), wire)
    assert 1.0 < beside["curve_px"] <= 3.0
    assert beside["tip_px"] == pytest.approx(3.0)


def test_what_is_missed_and_found_for_nothing_is_counted() -> None:
    images = RandomFluoroscopy(FluoroscopySettings(image_px=128, clutter=1e-6, no_wire=0.5), seed=2)
    rows: list[dict[str, Any]] = []
    for index in range(24):
        drawn = images.image(index)
        wires, curve = curve_of(drawn)
        truth: Array | None = None if curve is None else pixels_of_shares(curve, (128, 128))
        if wires == ONE and index % 2:
            truth = None
        elif wires != ONE and index % 2:
            truth = np.array([[1.0, 1.0], [20.0, 20.0]])
        rows.append(figures_of(drawn, truth))
    found = summary(rows)
    assert found["missed"] == sum(row["measured"] and not row["found"] for row in rows) > 0
    assert 0 < found["found_in_empty"] < found["empty"]
    assert found["curve_median_px"] < 0.1
    assert found["in_order"] == pytest.approx(1 - found["missed"] / found["images"])
    assert summary([])["curve_median_px"] is None
