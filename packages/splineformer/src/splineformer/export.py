"""Export to ONNX: a network as a graph without loops, checked against torch.

The published variant has every token unrolled; of the ordered one nothing has to be.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from guide3d.atomic_file import whole_file
from splineformer.modeling.curve_network import CurveNetwork

_GREYEST = 255.0


@dataclass(frozen=True)
class Graph:
    """A network with tensors in and tensors out."""

    module: nn.Module
    inputs: dict[str, Tensor]  # examples by name
    outputs: tuple[str, ...]


class _Ordered(nn.Module):
    outputs = ("control", "points", "spread", "on_wire", "wires", "inverted")

    def __init__(self, network: Any) -> None:
        super().__init__()
        self.network = network

    def forward(self, levels: Tensor) -> tuple[Tensor, ...]:
        curve = self.network(levels)
        return curve.control, curve.stages[-1], curve.spread, curve.on_wire, curve.kind.wires, curve.kind.inverted


class _Published(nn.Module):
    """Every step up to the limit; where the sequence ends is read off the end probabilities afterwards."""

    outputs = ("tokens", "end", "wires", "inverted")

    def __init__(self, network: Any) -> None:
        super().__init__()
        self.network = network

    def forward(self, levels: Tensor) -> tuple[Tensor, ...]:
        network = self.network
        x = network.normalised(levels)
        features = network.encoder(x)
        cache = network.decoder.begin(features)
        token = network.tip(x)[:, None]
        tokens, ends = [token], [torch.zeros_like(token[:, :, 0])]
        for _ in range(network.limit - 1):
            following = network.decoder.step(token, cache)
            token = following.tokens
            tokens.append(token)
            ends.append(torch.sigmoid(following.end))
        kind = network.kind(features)
        return torch.cat(tokens, 1), torch.cat(ends, 1), kind.wires, kind.inverted


_MODULES: dict[str, Any] = {"published": _Published, "ordered": _Ordered}


def graph_of(network: CurveNetwork, batch: int = 1, seed: int = 0) -> Graph:
    """The network as a graph, for a number of images at once, with random examples of a seed."""
    size = network.settings.image_px
    generator = torch.Generator().manual_seed(seed)
    levels = _GREYEST * torch.rand(batch, 1, size, size, generator=generator)
    module = _MODULES[network.variant](network).eval()
    return Graph(module, {"levels": levels}, module.outputs)


def export_onnx(network: CurveNetwork, path: Path | str, batch: int = 1) -> list[Path]:
    """Writes a network as ONNX, for a fixed number of images; returns the files that were written, whole.

    Raises:
        ModuleNotFoundError: the extra `splineformer[onnx]` is not installed.
    """
    _require("onnx", "onnxscript")
    graph = graph_of(network, batch)
    program = torch.onnx.export(
        graph.module,
        tuple(graph.inputs.values()),
        input_names=list(graph.inputs),
        output_names=list(graph.outputs),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    file = Path(path).with_suffix(".onnx")
    with whole_file(file) as stream:
        stream.write(program.model_proto.SerializeToString())
    return [file]


def onnx_difference(network: CurveNetwork, path: Path | str, batch: int = 1, seed: int = 1) -> dict[str, float]:
    """Compares an ONNX file with the network it was made of, on random inputs.

    Returns:
        The largest absolute difference of each output.

    Raises:
        ModuleNotFoundError: onnxruntime is not installed.
    """
    _require("onnxruntime")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    graph = graph_of(network, batch, seed)
    file = str(Path(path).with_suffix(".onnx"))
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    theirs = session.run(list(graph.outputs), {name: value.numpy() for name, value in graph.inputs.items()})
    with torch.no_grad():
        ours = graph.module(*graph.inputs.values())
    return {name: float(np.abs(a - b.numpy()).max()) for name, a, b in zip(graph.outputs, theirs, ours, strict=True)}


def _require(*modules: str) -> None:
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(f"ONNX needs {', '.join(missing)}: pip install 'endonav-splineformer[onnx]'")
