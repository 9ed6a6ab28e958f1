"""Pretrained weights: timm's and torchvision's names, another grid, colour filters, and files that are none."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from guide3d.modeling.pretrained import load_pretrained
from guide3d.modeling.vision_transformer import VisionTransformer

TIMM = {
    "class_token": "cls_token",
    "positions": "pos_embed",
    "patches.": "patch_embed.proj.",
    "attention_norm": "norm1",
    "attention.query_key_value": "attn.qkv",
    "attention.projection": "attn.proj",
    "feedforward_norm": "norm2",
    "feedforward.expand": "mlp.fc1",
    "feedforward.contract": "mlp.fc2",
}
TORCHVISION = {
    "positions": "encoder.pos_embedding",
    "patches.": "conv_proj.",
    "blocks.0": "encoder.layers.encoder_layer_0",
    "blocks.1": "encoder.layers.encoder_layer_1",
    "attention_norm": "ln_1",
    "attention.query_key_value.": "self_attention.in_proj_",
    "attention.projection": "self_attention.out_proj",
    "feedforward_norm": "ln_2",
    "feedforward.expand": "mlp.linear_1",
    "feedforward.contract": "mlp.linear_2",
}


def network(channels: int = 1, image_px: int = 32, width: int = 16) -> VisionTransformer:
    return VisionTransformer(
        image_px=image_px, patch_px=8, channels=channels, width=width, depth=2, heads=2, hidden=32
    ).eval()


def renamed(source: VisionTransformer, names: dict[str, str]) -> dict[str, torch.Tensor]:
    weights = {}
    for name, value in source.state_dict().items():
        new = re.sub(r"^norm\.", "encoder.ln." if names is TORCHVISION else "norm.", name)
        for mine, theirs in names.items():
            new = new.replace(mine, theirs)
        weights[new] = value
    return weights | {("heads.head.weight" if names is TORCHVISION else "head.weight"): torch.zeros(3, 16)}


@pytest.mark.parametrize("names", [TIMM, TORCHVISION], ids=["timm", "torchvision"])
def test_weights_under_other_names_make_the_same_network(tmp_path: Path, names: dict[str, str]) -> None:
    source, target = network(channels=3), network()
    torch.save(renamed(source, names), tmp_path / "vit.pt")
    load_pretrained(target, tmp_path / "vit.pt")
    grey = torch.rand(1, 1, 32, 32)
    assert torch.allclose(target(grey), source(grey.expand(-1, 3, -1, -1)), atol=1e-5)


def test_positions_are_interpolated_to_another_grid(tmp_path: Path) -> None:
    source, target = network(image_px=64), network(image_px=32)
    with torch.no_grad():
        source.positions[:, 1:] = torch.linspace(0, 1, 8).repeat_interleave(8)[None, :, None]  # rises downwards
    torch.save({"state_dict": renamed(source, TIMM)}, tmp_path / "vit.pt")
    load_pretrained(target, tmp_path / "vit.pt")
    rows = target.positions[0, 1:, 0].reshape(4, 4)
    assert (rows.diff(dim=0) > 0.1).all()
    assert torch.allclose(target.positions[:, 0], source.positions[:, 0])


def test_files_that_are_no_such_weights_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "vit.pt"
    with pytest.raises(FileNotFoundError, match="there are no pretrained weights"):
        load_pretrained(network(), file)
    file.write_bytes(b"no weights at all")
    with pytest.raises(ValueError, match=r"no file of weights that torch\.load reads safely"):
        load_pretrained(network(), file)
    torch.save({"layer.weight": torch.zeros(3)}, file)
    with pytest.raises(ValueError, match="weights of no vision transformer that timm or torchvision makes"):
        load_pretrained(network(), file)
    torch.save(renamed(network(width=8), TIMM), file)
    with pytest.raises(ValueError, match=r"of another size: class_token should be \(1, 1, 16\)"):
        load_pretrained(network(), file)
    torch.save([1, 2], file)
    with pytest.raises(ValueError, match="holds a list, not a state dictionary"):
        load_pretrained(network(), file)
