"""Predictor: an image in, a curve out; warnings, batches, files of models, the compiler."""

from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.learning.model_file import read_content, write_content
from splineformer.build import VARIANTS, build, size_of
from splineformer.image_input import picture_of, shares_of_pixels
from splineformer.predictor import Predictor
from splineformer.tokens import sampled, tokens_of_polyline, tokens_px
from tests.damaged_files import refusals
from tests.splineformer.curves import image_of, wavy_wire


def untrained(variant: str) -> Predictor:
    torch.manual_seed(0)
    return Predictor(build(size_of(variant, "smoke")), source_px=256)


def answering(predictor: Predictor, wires: int = 1, inverted: bool = False) -> Predictor:
    """The predictor with a head that always says the same."""
    head = predictor.network.kind
    for layer in (head.wires, head.inverted):
        torch.nn.init.zeros_(layer.weight)
    head.wires.bias.data = 9.0 * torch.eye(3)[wires]
    torch.nn.init.constant_(head.inverted.bias, 9.0 if inverted else -9.0)
    return predictor


@pytest.mark.parametrize("variant", VARIANTS)
def test_prediction_is_a_curve_in_pixels(variant: str) -> None:
    predictor = answering(untrained(variant))
    image = image_of(wavy_wire(0))
    prediction = predictor(image)
    assert prediction.wires == "one"
    assert not prediction.warnings
    assert np.allclose(prediction.curve.at(0.0), prediction.tip_px)
    assert len(prediction.curve.knots) == len(prediction.control_points_px) + 4
    points = prediction.points(50)
    assert points.shape == (50, 2)
    steps = np.linalg.norm(np.diff(prediction.curve.sample(2000), axis=0), axis=1).sum()
    assert prediction.curve.knots[-1] == pytest.approx(steps, rel=0.02)  # knots are the way along the curve
    assert 0 <= prediction.confidence <= 1
    batch = predictor.batch([image, image_of(wavy_wire(1)), image])
    assert np.allclose(batch[0].tokens, prediction.tokens, atol=1e-3)
    assert np.allclose(batch[0].tokens, batch[2].tokens, atol=1e-3)


def test_no_wire_and_several_wires_are_said() -> None:
    image = image_of(wavy_wire(0))
    none = answering(untrained("ordered"), 0)(image)
    assert none.wires == "none"
    assert none.tokens is None
    assert "no wire" in none.warnings[0]
    with pytest.raises(ValueError, match="shows no wire"):
        none.points()
    several = answering(untrained("ordered"), 2)(image)
    assert several.tokens is not None
    assert several.confidence < 0.01
    assert "more than one wire" in several.warnings[0]


@pytest.mark.parametrize("variant", VARIANTS)
def test_inverted_images_are_turned_over(variant: str) -> None:
    image = image_of(wavy_wire(0, 64), 64)  # the network's own size: averaging would round
    plain, turned = answering(untrained(variant)), answering(untrained(variant), inverted=True)
    prediction = turned(255 - image)
    assert prediction.inverted
    assert "inverted" in prediction.warnings[-1]
    assert np.allclose(prediction.tokens, plain(image).tokens, atol=1e-3)


def test_other_sizes_and_depths() -> None:
    predictor = answering(untrained("ordered"))
    points = wavy_wire(0)
    image = image_of(points)
    deep = predictor(image.astype(np.uint16) * 200 + 1000)
    assert "were taken to 8 bits" in deep.warnings[0]
    twice = predictor(image.repeat(2, 0).repeat(2, 1))
    assert "512 x 512 px instead of 256 x 256" in twice.warnings[0]
    assert np.allclose(twice.tip_px + 0.5, 2 * (predictor(image).tip_px + 0.5), atol=0.1)
    assert np.allclose(predictor(np.stack([image] * 3, -1)).tokens, predictor(image).tokens)
    wide = picture_of(image[:128], 64, 256)
    assert wide.side_px == 256
    assert not wide.pixels[40:].any()


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 4, 7)), "expected a grey image"),
        (np.zeros((20, 20), np.uint8), "at least 64 x 64 px"),
        (np.full((100, 100), 7, np.uint8), "no contrast"),
        (np.full((100, 100), np.nan), "finite"),
        (np.arange(30000, dtype=np.uint16).reshape(3, 100, 100).transpose(1, 2, 0), "coloured"),
    ],
)
def test_what_is_no_image(image: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        untrained("ordered")(image)
    with pytest.raises(ValueError, match="image 1: "):
        untrained("ordered").batch([image_of(wavy_wire(0)), image])


@pytest.mark.parametrize("variant", VARIANTS)
def test_file_of_a_model(variant: str, tmp_path: Path) -> None:
    predictor = answering(untrained(variant))
    predictor.save(tmp_path / "model.pt", epochs=3)
    again = Predictor.load(tmp_path / "model.pt")
    assert again.source_px == 256
    image = image_of(wavy_wire(2))
    assert np.array_equal(again(image).tokens, predictor(image).tokens)


def test_files_of_other_versions(tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    with pytest.raises(FileNotFoundError, match="train one first"):
        Predictor.load(path)
    path.write_bytes(b"not a network")
    with pytest.raises(ValueError, match="damaged or no network"):
        Predictor.load(path)
    untrained("ordered").save(path)
    content = read_content(path)
    for change, message in (
        ({"format": "guide3d-network-0"}, "no network of format"),
        ({"kind": "shape"}, "kind 'shape', expected splineformer"),
        ({"network": content["network"] | {"layout": 7}}, "layout 7, this version reads 2"),
        ({"weights": {}}, "cannot be used"),
    ):
        write_content(path, content | change)
        with pytest.raises(ValueError, match=message):
            Predictor.load(path)


def test_a_wrong_bit_is_refused(tmp_path: Path) -> None:
    untrained("ordered").save(tmp_path / "model.pt")
    messages = refusals(tmp_path / "model.pt", lambda: Predictor.load(tmp_path / "model.pt"))
    assert all("model.pt is damaged or no network" in message for message in messages)


def test_graph_for_the_compiler_agrees() -> None:
    image = image_of(wavy_wire(0))
    plain = answering(untrained("ordered"))
    # the machine code is checked by benchmarks/splineformer/reading.py: making it takes too long here
    calls: list[int] = []

    def backend(graph: torch.fx.GraphModule, given: object) -> object:
        calls.append(len(graph.graph.nodes))
        return graph.forward

    compiled = Predictor(plain.network, source_px=256, compiled=True, backend=backend)
    assert np.allclose(compiled(image).tokens, plain(image).tokens, atol=1e-3)
    assert calls  # the compiler was asked
    before = len(calls)
    plain(image)
    assert len(calls) == before  # and only for the compiled predictor


def test_tokens_in_pixels_trace_the_same_curve() -> None:
    points = wavy_wire(3, 1024)
    tokens = tokens_of_polyline(points)
    shares = tokens.copy()
    shares[:, 0] /= shares[-1, 0]
    shares[:, 1:] = shares_of_pixels(tokens[:, 1:], (1024, 1024))
    assert np.abs(sampled(tokens_px(shares, 1024.0), 60) - sampled(tokens, 60)).max() < 0.1
