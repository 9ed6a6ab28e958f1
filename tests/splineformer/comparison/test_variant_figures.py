"""Figures of a variant alone: round trips of curves as tokens, and whether the kind of an image is recognised."""

from __future__ import annotations

import time

import numpy as np
import pytest
import torch

from guide3d.dataset.dataset import Dataset
from splineformer.build import VARIANTS, build, size_of
from splineformer.comparison.fluoroscopy_figures import kind_accuracy, round_trips, speed
from splineformer.predictor import Predictor
from tests.guide3d.learning.drawn_data import draw
from tests.splineformer.curves import image_of, wavy_wire


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return draw(tmp_path_factory.mktemp("drawn"))


def predictor(variant: str = "ordered") -> Predictor:
    torch.manual_seed(0)
    return Predictor(build(size_of(variant, "smoke")), source_px=128)


@pytest.mark.parametrize("variant", VARIANTS)
def test_curves_survive_as_tokens(variant: str) -> None:
    network = predictor(variant).network
    curves = [wavy_wire(seed, 1024) for seed in range(4)]
    trips = round_trips(network.fit_tokens, curves)
    assert 0 < trips["round_trip_px"] <= trips["round_trip_max_px"] < 20
    assert trips["tokens_max"] <= network.limit
    one_off = round_trips(lambda points: network.fit_tokens(points) + np.array([0.0, 40.0, 0.0]), curves)
    assert one_off["round_trip_px"] > 10 * trips["round_trip_px"]


def test_what_a_network_that_always_says_the_same_recognises(data: Dataset) -> None:
    reader = predictor()
    head = reader.network.kind
    for layer in (head.wires, head.inverted):
        torch.nn.init.zeros_(layer.weight)
    head.wires.bias.data = torch.tensor([9.0, 0.0, 0.0])  # no wire
    torch.nn.init.constant_(head.inverted.bias, -9.0)
    shares = kind_accuracy(reader, data, [0, 30])
    assert shares == {"one": 0.0, "none": 100.0, "several": 0.0, "inverted": 0.0}
    head.wires.bias.data = torch.tensor([0.0, 9.0, 0.0])
    assert kind_accuracy(reader, data, [0, 30]) == {"one": 100.0, "none": 0.0, "several": 0.0, "inverted": 0.0}
    torch.nn.init.constant_(head.inverted.bias, 9.0)
    assert kind_accuracy(reader, data, [0, 30]) == {"one": 0.0, "none": 0.0, "several": 0.0, "inverted": 100.0}


def test_speed_counts_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = predictor()
    batches: list[int] = []
    read = reader.batch
    monkeypatch.setattr(reader, "batch", lambda images: batches.append(len(images)) or read(images))
    figures = speed(reader, image_of(wavy_wire(0, 128), 128), calls=2)
    assert batches == [1, 1, 1, 8, 8, 8]
    assert figures["latency_ms"] > 0
    assert np.isfinite(figures["images_per_s"])


def test_a_slow_network_is_timed_by_the_calls_that_begin_within_two_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, batches, spent = predictor(), [], [0.0]

    def slow(images: list[np.ndarray]) -> None:
        batches.append(len(images))
        spent[0] += 1.5

    monkeypatch.setattr(reader, "batch", slow)
    monkeypatch.setattr(time, "process_time", lambda: spent[0])
    figures = speed(reader, image_of(wavy_wire(0, 128), 128), calls=5)
    assert batches == [1, 1, 1, 8, 8, 8]
    assert figures == {"latency_ms": 1500.0, "images_per_s": 8 / 1.5}
