"""Export to ONNX: a network as a graph without loops, checked against torch.

The published variant has every token unrolled; of the ordered one nothing has to be.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from guide3d.files import whole_file
from splineformer.modeling.curve_network import CurveNetwork

_GREYEST = 255.0


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


def graph_of(network: CurveNetwork, batch: int = 1, seed: int = 0) -> tuple[Any, Tensor]:
    """The network as a module of tensors with named `outputs`, and its input "levels": random images of a seed."""
    size = network.settings.image_px
    generator = torch.Generator().manual_seed(seed)
    levels = _GREYEST * torch.rand(batch, 1, size, size, generator=generator)
    return _MODULES[network.variant](network).eval(), levels


def export_onnx(network: CurveNetwork, path: Path | str, batch: int = 1) -> list[Path]:
    """Writes a network as ONNX, for a fixed number of images; returns the files that were written, whole.

    Raises:
        ModuleNotFoundError: the extra `endonav-splineformer[onnx]` is not installed.
    """
    _require("onnx", "onnxscript")
    module, levels = graph_of(network, batch)
    program = torch.onnx.export(
        module, (levels,), input_names=["levels"], output_names=list(module.outputs), dynamo=True, verbose=False
    )
    assert program is not None
    file = Path(path).with_suffix(".onnx")
    with whole_file(file) as stream:
        stream.write(program.model_proto.SerializeToString())
    return [file]


def onnx_difference(network: CurveNetwork, path: Path | str, batch: int = 1) -> dict[str, float]:
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
    module, levels = graph_of(network, batch, seed=1)
    file = str(Path(path).with_suffix(".onnx"))
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    theirs = session.run(list(module.outputs), {"levels": levels.numpy()})
    with torch.no_grad():
        ours = module(levels)
    return {name: float(np.abs(a - b.numpy()).max()) for name, a, b in zip(module.outputs, theirs, ours, strict=True)}


def _require(*modules: str) -> None:
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(f"ONNX needs {', '.join(missing)}: pip install 'endonav-splineformer[onnx]'")
