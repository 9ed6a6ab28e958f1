"""Pretrained weights of a vision transformer: a user's file in timm's or torchvision's names, read into this package's.

Grey images have one channel where photographs have three: the colour filters are summed. Positions of another grid
are interpolated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from guide3d.guarded_reading import open_regular
from guide3d.learning.bounded_content import load_content
from guide3d.learning.model_file import LARGEST_BYTES
from guide3d.modeling.vision_transformer import VisionTransformer

# this package's name, timm's pattern, torchvision's pattern
_NAMES = (
    ("class_token", r"cls_token", r"class_token"),
    ("positions", r"pos_embed", r"encoder\.pos_embedding"),
    (r"patches.\1", r"patch_embed\.proj\.(.+)", r"conv_proj\.(.+)"),
    (r"blocks.\1.attention_norm.\2", r"BLOCK\.norm1\.(.+)", r"LAYER\.ln_1\.(.+)"),
    (r"blocks.\1.attention.query_key_value.\2", r"BLOCK\.attn\.qkv\.(.+)", r"LAYER\.self_attention\.in_proj_(.+)"),
    (r"blocks.\1.attention.projection.\2", r"BLOCK\.attn\.proj\.(.+)", r"LAYER\.self_attention\.out_proj\.(.+)"),
    (r"blocks.\1.feedforward_norm.\2", r"BLOCK\.norm2\.(.+)", r"LAYER\.ln_2\.(.+)"),
    (r"blocks.\1.feedforward.expand.\2", r"BLOCK\.mlp\.fc1\.(.+)", r"LAYER\.mlp\.(?:linear_1|0)\.(.+)"),
    (r"blocks.\1.feedforward.contract.\2", r"BLOCK\.mlp\.fc2\.(.+)", r"LAYER\.mlp\.(?:linear_2|3)\.(.+)"),
    (r"norm.\1", r"norm\.(.+)", r"encoder\.ln\.(.+)"),
)
_TIMM = tuple((name.replace("BLOCK", r"blocks\.(\d+)"), own) for own, name, _ in _NAMES)
_TORCHVISION = tuple((name.replace("LAYER", r"encoder\.layers\.encoder_layer_(\d+)"), own) for own, _, name in _NAMES)
# Of classification: nothing here classifies.
_UNUSED = re.compile(r"(head|heads|pre_logits|fc_norm)\..+")


def load_pretrained(network: VisionTransformer, file: Path | str) -> None:
    """Fills a vision transformer with weights that somebody else has trained.

    Args:
        network: to be filled; patches cut by one convolution, as published.
        file: a state dictionary written by `torch.save`, in timm's or torchvision's names.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it holds no vision transformer, or one of other sizes.
    """
    file = Path(file)
    if not file.is_file():
        raise FileNotFoundError(f"there are no pretrained weights {file}: leave them out to train from nothing")
    try:
        with open_regular(file, LARGEST_BYTES) as stream:
            content = load_content(stream.read())
    except Exception as error:
        raise ValueError(
            f"{file} is no file of weights that torch.load reads safely ({type(error).__name__}): save the network's "
            "state_dict() with torch.save"
        ) from error
    for wrapping in ("state_dict", "model"):
        if isinstance(content, Mapping) and isinstance(content.get(wrapping), Mapping):
            content = content[wrapping]
    if not isinstance(content, Mapping):
        raise ValueError(f"{file} holds a {type(content).__name__}, not a state dictionary of a vision transformer")
    weights = _renamed(content, file)
    own = network.state_dict()
    if "patches.weight" not in own:
        raise ValueError(f"{file}: a network with a convolutional stem takes no pretrained weights; build size thesis")
    filters = weights["patches.weight"]
    if filters.ndim == 4 and own["patches.weight"].shape[1] == 1 and filters.shape[1] == 3:
        weights["patches.weight"] = filters.sum(1, keepdim=True)
    weights["positions"] = _on_grid(weights["positions"], network.grid)
    wrong = [name for name in own if name not in weights or weights[name].shape != own[name].shape]
    extra = [name for name in weights if name not in own]
    if wrong or extra:
        name = (wrong or extra)[0]
        shape = tuple(own[name].shape) if name in own else "nothing"
        got = tuple(weights[name].shape) if name in weights else "nothing"
        raise ValueError(
            f"{file} is a vision transformer of another size: {name} should be {shape}, the file has {got}"
        )
    network.load_state_dict(weights)


def _renamed(content: Mapping[Any, Any], file: Path) -> dict[str, Tensor]:
    odd = [name for name, value in content.items() if not isinstance(name, str) or not isinstance(value, Tensor)]
    spoilt = [name for name, value in content.items() if name not in odd and not bool(torch.isfinite(value).all())]
    if odd or spoilt:
        problem = f"{odd[0]} is no tensor" if odd else f"{spoilt[0]} is not finite"
        raise ValueError(f"{file} has no weights of a vision transformer that can be used: {problem}")
    names = [name for name in content if not _UNUSED.fullmatch(name)]
    for rules in (_TIMM, _TORCHVISION):
        weights = {new: content[name] for name in names if (new := _translated(name, rules)) is not None}
        if {"class_token", "positions", "patches.weight"} <= weights.keys():
            return weights
    excerpt = ", ".join(names[:3]) or "nothing"
    raise ValueError(
        f"{file} has the weights of no vision transformer that timm or torchvision makes: it has {excerpt} …"
    )


def _translated(name: str, rules: tuple[tuple[str, str], ...]) -> str | None:
    for pattern, replacement in rules:
        match = re.fullmatch(pattern, name)
        if match:
            return match.expand(replacement)
    return None


def _on_grid(positions: Tensor, grid: int) -> Tensor:
    count = positions.shape[1] - 1 if positions.ndim == 3 else 0
    side = round(max(count, 0) ** 0.5)
    if side == grid or side == 0 or side**2 != count:
        return positions
    patches = positions[:, 1:].reshape(1, side, side, -1).permute(0, 3, 1, 2)
    patches = functional.interpolate(patches, size=(grid, grid), mode="bicubic", align_corners=False)
    return torch.cat((positions[:, :1], patches.permute(0, 2, 3, 1).flatten(1, 2)), dim=1)
