"""Export to ONNX: the networks as graphs without loops, checked against torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from guide3d.atomic_file import whole_file
from splineformer.build import Network
from splineformer.modeling.splineformer import SplineFormer

INPUT = "levels"
ORDERED_OUTPUTS = ("control", "spread", "wires", "inverted")
PUBLISHED_OUTPUTS = ("tokens", "end", "wires", "inverted")


class _OrderedGraph(nn.Module):
    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, levels: Tensor) -> tuple[Tensor, ...]:
        said = self.network(levels)
        return said.control, said.spread, said.kind.wires, said.kind.inverted


class _PublishedGraph(nn.Module):
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


def graph(network: Network) -> tuple[nn.Module, tuple[str, ...]]:
    """The network as a module of tensors in and tensors out, and the names of what comes out."""
    if isinstance(network, SplineFormer):
        return _PublishedGraph(network).eval(), PUBLISHED_OUTPUTS
    return _OrderedGraph(network).eval(), ORDERED_OUTPUTS


def export_onnx(network: Network, path: Path | str, batch: int = 1) -> None:
    """Writes a network as ONNX, for a fixed number of images.

    Args:
        network: either variant.
        path: of the file; it appears whole or not at all.
        batch: images at once.

    Raises:
        ModuleNotFoundError: the extra `splineformer[onnx]` is not installed.
    """
    _require("onnx", "onnxscript")
    module, outputs = graph(network)
    size = network.settings.image_px
    levels = torch.rand(batch, 1, size, size, generator=torch.Generator().manual_seed(0)) * 255
    program = torch.onnx.export(
        module, (levels,), input_names=[INPUT], output_names=list(outputs), dynamo=True, verbose=False
    )
    assert program is not None
    content = program.model_proto.SerializeToString()
    with whole_file(path) as file:
        file.write(content)


def onnx_difference(network: Network, path: Path | str, levels: Tensor) -> dict[str, float]:
    """Compares an ONNX file with the network it was made of.

    Args:
        network: that was exported.
        path: of the file.
        levels: (batch, 1, image_px, image_px) grey levels of 0 to 255.

    Returns:
        The largest absolute difference of each output.

    Raises:
        ModuleNotFoundError: onnxruntime is not installed.
    """
    _require("onnxruntime")
    import onnxruntime  # type: ignore[import-untyped]

    module, outputs = graph(network)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    theirs = session.run(list(outputs), {INPUT: levels.numpy()})
    with torch.no_grad():
        ours = module(levels)
    return {name: float(np.abs(a - b.numpy()).max()) for name, a, b in zip(outputs, theirs, ours, strict=True)}


def _require(*modules: str) -> None:
    import importlib.util

    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(f"ONNX needs {', '.join(missing)}: pip install 'endonav-splineformer[onnx]'")
