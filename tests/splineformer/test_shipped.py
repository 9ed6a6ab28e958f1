"""Predictors: an image in, a curve out; their files, the shipped network, exports, drawn images and real ones."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import splineformer
from benchmarks.splineformer.xray_curves import main
from guide3d import shipped as shelf
from guide3d.learning.model_file import read_content, write_content
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer import shipped
from splineformer.attention import attention_map
from splineformer.build import VARIANTS, build, size_of
from splineformer.comparison.fluoroscopy_figures import curve_figures
from splineformer.export import export_onnx, onnx_difference
from splineformer.image_input import shares_of_pixels
from splineformer.predictor import Predictor
from splineformer.tokens import sampled, tokens_of_polyline, tokens_px
from tests.guide3d.real_images import real_folder
from tests.splineformer.curves import answering, image_of, network, wavy_wire


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of the installed weights, with an untrained network of the shipped variant."""
    monkeypatch.setattr(shelf, "files", lambda package: tmp_path / package)
    weights = tmp_path / "splineformer.weights"
    weights.mkdir()
    Predictor(network("ordered"), source_px=256).save(weights / "ordered.pt")
    (weights / "ordered.md").write_text("# ordered\n\nReads a wire.\n\nmore\n")
    return weights


def test_the_shipped_network_predicts(folder: Path) -> None:
    assert splineformer.models() == {"ordered": "Reads a wire."}
    assert shipped.card("ordered").startswith("# ordered")
    image = image_of(wavy_wire(0))
    own, loaded = Predictor.load(folder / "ordered.pt"), Predictor.pretrained()
    assert loaded.source_px == 256
    assert np.isclose(own(image).confidence, loaded(image).confidence)


def test_another_name_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="there is no model 'published': choose from ordered"):
        Predictor.pretrained("published")


@pytest.mark.slow
@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("onnx", "onnxruntime", "onnxscript")),
    reason="the extra splineformer[onnx] is not installed",
)
@pytest.mark.parametrize("variant", VARIANTS)
def test_onnx_agrees_with_torch(variant: str, tmp_path: Path) -> None:
    # a small graph: every token is a part of its own, and so is every scale
    fewer = {"published": {"limit": 3}, "ordered": {"image_px": 16, "channels": (4, 8), "blocks": (0, 0)}}
    model = build(replace(size_of(variant, "smoke"), **fewer[variant])).eval()
    files = export_onnx(model, tmp_path / "model.onnx", batch=2)
    assert max(onnx_difference(model, tmp_path / "model.onnx", batch=2).values()) < 1e-3
    assert sorted(tmp_path.iterdir()) == sorted(files)


PLAIN = FluoroscopySettings(clutter=1e-6, contrast=0.0, catheter=0.0, two_devices=0.0, no_wire=0.0, weakest=0.7)


def test_a_drawn_wire_is_read() -> None:
    wire = np.column_stack([np.linspace(420, 1060, 200), 500 + 60 * np.sin(np.linspace(0, 3, 200))])
    image = RandomFluoroscopy(PLAIN, seed=1_000_003).along(0, [wire]).image
    prediction = Predictor.pretrained()(image)
    assert prediction.wires == "one"
    figures = curve_figures(prediction.points(), wire[wire[:, 0] <= 1023])
    assert figures["curve_px"] < 10
    assert figures["tip_px"] < 10


def test_attention_is_of_the_picture_that_the_predictor_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    predictor, seen = Predictor.pretrained(), []
    attention = predictor.network.attention
    monkeypatch.setattr(predictor.network, "attention", lambda levels: seen.append(levels) or attention(levels))
    image = image_of(wavy_wire(0))
    assert attention_map(predictor, image).shape == image.shape
    np.testing.assert_array_equal(seen[0][0, 0], predictor.picture(image).pixels)


def test_the_benchmark_of_real_images_stays_near_its_figures(capsys: pytest.CaptureFixture[str]) -> None:
    real = str(real_folder() / "xray_wires"), str(real_folder() / "stereo_pairs.json")
    assert main(["--images", "0", "--alone", "--real", *real]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["images"] == 12
    assert found["missed"] == 0
    assert found["curve_median_px"] < 6
    assert found["tip_median_px"] < 8


def untrained(variant: str) -> Predictor:
    return Predictor(network(variant), source_px=256)


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


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 4, 7)), "expected a grey image"),
        (np.zeros((20, 20), np.uint8), "at least 64 x 64 px"),
        (np.arange(30000, dtype=np.uint16).reshape(3, 100, 100).transpose(1, 2, 0), "coloured"),
    ],
)
def test_what_is_no_image(image: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        untrained("ordered")(image)
    with pytest.raises(ValueError, match="image 1: "):
        untrained("ordered").batch([image_of(wavy_wire(0)), image])


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


@pytest.mark.parametrize("variant", VARIANTS)
def test_file_of_a_model(variant: str, tmp_path: Path) -> None:
    predictor, path = answering(untrained(variant)), tmp_path / "model.pt"
    with pytest.raises(FileNotFoundError, match="train one first"):
        Predictor.load(path)
    predictor.save(path, epochs=3)
    again = Predictor.load(path)
    assert again.source_px == 256
    image = image_of(wavy_wire(2))
    assert np.array_equal(again(image).tokens, predictor(image).tokens)
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
    path.write_bytes(b"not a network")
    with pytest.raises(ValueError, match="damaged or no network"):
        Predictor.load(path)
