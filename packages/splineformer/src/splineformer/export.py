"""Export to ONNX: a network as a graph without loops, checked against torch.

The published variant has every token unrolled; of the ordered one nothing has to be.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from guide3d.atomic_file import whole_file
from splineformer.build import Network
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.splineformer import SplineFormer

_GREYEST = 255.0


@dataclass(frozen=True)
class Graph:
    """A part of a network with tensors in and tensors out.

    Attributes:
        module: that computes it.
        inputs: names and examples.
        outputs: names.
    """

    module: nn.Module
    inputs: dict[str, Tensor]
    outputs: tuple[str, ...]


class _Ordered(nn.Module):
    def __init__(self, network: OrderedSplineFormer) -> None:
        super().__init__()
        self.network = network

    def forward(self, levels: Tensor) -> tuple[Tensor, ...]:
        said = self.network(levels)
        return said.control, said.stages[-1], said.spread, said.on_wire, said.kind.wires, said.kind.inverted


class _Published(nn.Module):
    """Every step up to the limit; where the sequence ends is read off the end probabilities afterwards."""

    def __init__(self, network: SplineFormer) -> None:
        super().__init__()
        self.network = network

    def forward(self, levels: Tensor) -> tuple[Tensor, ...]:
        network = self.network
        x = network.normalised(levels)
        memory = network.encoder(x)
        cache = network.decoder.begin(memory)
        token = network.tip(x)[:, None]
        tokens, ends = [token], [torch.zeros_like(token[:, :, 0])]
        for _ in range(network.settings.limit - 1):
            following = network.decoder.step(token, cache)
            token = following.tokens
            tokens.append(token)
            ends.append(torch.sigmoid(following.end))
        kind = network.kind(memory)
        return torch.cat(tokens, 1), torch.cat(ends, 1), kind.wires, kind.inverted


def graphs(network: Network, batch: int = 1, seed: int = 0) -> dict[str, Graph]:
    """The network in graphs: ending of the file to the graph, with random examples.

    Args:
        network: either variant.
        batch: images at once.
        seed: of the examples.
    """
    size = network.settings.image_px
    generator = torch.Generator().manual_seed(seed)
    levels = {"levels": _GREYEST * torch.rand(batch, 1, size, size, generator=generator)}
    if isinstance(network, SplineFormer):
        return {".onnx": Graph(_Published(network).eval(), levels, ("tokens", "end", "wires", "inverted"))}
    outputs = ("control", "points", "spread", "on_wire", "wires", "inverted")
    return {".onnx": Graph(_Ordered(network).eval(), levels, outputs)}


def export_onnx(network: Network, path: Path | str, batch: int = 1) -> list[Path]:
    """Writes a network as ONNX, for a fixed number of images.

    Args:
        network: either variant.
        path: of the file, ``model.onnx``; each file appears whole or not at all.
        batch: images at once.

    Returns:
        The files that were written.

    Raises:
        ModuleNotFoundError: the extra `splineformer[onnx]` is not installed.
    """
    _require("onnx", "onnxscript")
    written = []
    for ending, graph in graphs(network, batch).items():
        program = torch.onnx.export(
            graph.module,
            tuple(graph.inputs.values()),
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamo=True,
            verbose=False,
        )
        assert program is not None
        file = Path(path).with_suffix(ending)
        with whole_file(file) as stream:
            stream.write(program.model_proto.SerializeToString())
        written.append(file)
    return written


def onnx_difference(network: Network, path: Path | str, batch: int = 1, seed: int = 1) -> dict[str, float]:
    """Compares ONNX files with the network they were made of, on random inputs.

    Args:
        network: that was exported.
        path: of the file, as `export_onnx` got it.
        batch: likewise.
        seed: of the inputs.

    Returns:
        The largest absolute difference of each output.

    Raises:
        ModuleNotFoundError: onnxruntime is not installed.
    """
    _require("onnxruntime")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    told = {}
    for ending, graph in graphs(network, batch, seed).items():
        file = str(Path(path).with_suffix(ending))
        session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
        theirs = session.run(list(graph.outputs), {name: value.numpy() for name, value in graph.inputs.items()})
        with torch.no_grad():
            ours = graph.module(*graph.inputs.values())
        for name, a, b in zip(graph.outputs, theirs, ours, strict=True):
            told[name] = float(np.abs(a - b.numpy()).max())
    return told


def _require(*modules: str) -> None:
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(f"ONNX needs {', '.join(missing)}: pip install 'endonav-splineformer[onnx]'")
