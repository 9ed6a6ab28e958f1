"""Benchmark of SplineFormer: how curves survive as tokens, and how long an image takes.

    python benchmarks/splineformer/reading.py [--quick] [--data DATASET] [--model predictor.pt] [--exports]

Without a data set the curves are drawn wires seen by two cameras; without a model the networks have the desk size and
random weights, which takes as long. Prints a table and, as its last line, one JSON object; times are CPU time of one
thread, from the 1,024 px image to the curve:
    round_trip_px, round_trip_max_px   mean and largest mean distance of a curve from the curve of its tokens
    tokens_mean, tokens_max            tokens a curve
    latency_ms                         one image: the model, or else the ordered variant
    images_per_s                       in batches of eight
    published_latency_ms, published_images_per_s   the published variant, without --model
    compiled_latency_ms, compiled_difference_px    with --exports: by torch.compile
    onnx_latency_ms, onnx_difference_px            with --exports: by onnxruntime
    tip_px, mean_px, max_px, chamfer_px            with --data and --model: on the test acquisitions
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
# this file has the package's name: its folder, which comes first, must come last
sys.path.sort(key=lambda place: Path(place) == Path(__file__).resolve().parent)

import numpy as np
import torch

from guide3d.dataset.dataset import VIEWS, Dataset, images_of, split
from guide3d.dataset.frame import strip_mask
from guide3d.reconstruction.synthetic_scene import scenes
from splineformer.build import build, size_of
from splineformer.comparison.evaluation import curve_errors
from splineformer.comparison.fluoroscopy_figures import round_trips, speed
from splineformer.export import export_onnx, graph_of, onnx_difference
from splineformer.predictor import SOURCE_PX, Predictor
from splineformer.tokens import tokens_of_polyline


def cpu_ms(call: Callable[[], Any], times: int) -> float:
    """CPU time of a call, after one that is not counted."""
    call()
    began = time.process_time()
    for _ in range(times):
        call()
    return 1e3 * (time.process_time() - began) / times


def curves(arguments: argparse.Namespace) -> list[np.ndarray]:
    """Curves to turn into tokens."""
    count = 60 if arguments.quick else 600
    if arguments.data is None:
        drawn = scenes(count // 2, seed=0)
        return [points for scene in drawn for points in scene.points]
    frames = Dataset.open(arguments.data).frames
    chosen = np.linspace(0, len(frames) - 1, min(count // 2, len(frames))).astype(int)
    return [frames[index].polyline(camera) for index in chosen for camera in VIEWS]


def drawn_image() -> np.ndarray:
    """A 1,024 px image of a wire."""
    x = np.linspace(0, 700, 200)
    wire = strip_mask(np.column_stack([x, 500 + 120 * np.sin(x / 150)]), SOURCE_PX, SOURCE_PX, 5.0) > 0
    image = 140 + np.random.default_rng(0).normal(0, 2, wire.shape) - 50 * wire
    return np.clip(image, 0, 255).astype(np.uint8)


def exports(predictor: Predictor, times: int) -> dict[str, float]:
    """The ordered variant by other ways of computing it, and how far they differ."""
    import onnxruntime  # type: ignore[import-untyped]

    network, image = predictor.network, drawn_image()
    compiled = Predictor(network, compiled=True)
    measured = {"compiled_latency_ms": cpu_ms(lambda: compiled(image), times)}
    plain, other = predictor(image), compiled(image)
    if plain.tokens is not None and other.tokens is not None:
        measured["compiled_difference_px"] = float(np.abs(plain.tokens - other.tokens).max())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.onnx"
        export_onnx(network, file)
        measured["onnx_difference_px"] = SOURCE_PX * onnx_difference(network, file)["control"]
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        seen = {"levels": graph_of(network)[1].numpy()}
        measured["onnx_latency_ms"] = cpu_ms(lambda: session.run(["control"], seen), times)
    return measured


def accuracy(predictor: Predictor, arguments: argparse.Namespace) -> dict[str, float]:
    """Errors on acquisitions that were not learnt from (split of seed 0)."""
    data = Dataset.open(arguments.data)
    rows = []
    for item in images_of(data, split(data).test, 24 if arguments.quick else 0).tolist():
        camera, index = divmod(item, len(data.frames))
        prediction = predictor(data.frames[index].image(VIEWS[camera]))
        if prediction.tokens is not None:
            rows.append(curve_errors(prediction.points(), data.frames[index].polyline(VIEWS[camera])))
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer curves and images")
    parser.add_argument("--data", type=Path, help="folder of a data set")
    parser.add_argument("--model", type=Path, help="a trained model")
    parser.add_argument("--exports", action="store_true", help="torch.compile and ONNX, too; takes a minute")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    times = 4 if arguments.quick else 20
    measured: dict[str, Any] = round_trips(tokens_of_polyline, curves(arguments))
    if arguments.model is not None:
        predictor = Predictor.load(arguments.model)
    else:
        predictor = Predictor(build(size_of("ordered", "desk")))
        published = speed(Predictor(build(size_of("published", "desk"))), drawn_image(), times)
        measured |= {f"published_{name}": value for name, value in published.items()}
    measured |= speed(predictor, drawn_image(), times)
    if arguments.exports and predictor.network.variant == "ordered":
        measured |= exports(predictor, times)
    if arguments.data is not None and arguments.model is not None:
        measured |= accuracy(predictor, arguments)
    for name, value in measured.items():
        print(f"{name:26}{value:12.4g}")
    print(json.dumps({name: round(float(value), 5) for name, value in measured.items()}))


if __name__ == "__main__":
    main()
