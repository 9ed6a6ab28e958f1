"""Networks: published sizes, shapes, spherical steps, weights of other programs."""

import dataclasses
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.learning.build import (
    FGRN_SIZES,
    SEGMENTER_SIZES,
    SEGMENTERS,
    SHAPE_SIZES,
    build_segmenter,
    build_shape_network,
)
from guide3d.learning.recipes import segmentation_recipe
from guide3d.modeling.pretrained import load_pretrained
from guide3d.modeling.shape_network import FGRN
from guide3d.modeling.spherical import SphericalForm, steps_of_radius
from guide3d.modeling.swin_transformer import SwinBlock, SwinTransformer, SwinUnet
from guide3d.modeling.transunet import TransUnet
from guide3d.modeling.unet import UNet
from guide3d.modeling.vision_transformer import VisionTransformer
from tests.guide3d.learning.drawn_data import wire

FORM = SphericalForm(1.7, ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)), 0.0, 1.5708)
# What `thesis` builds, but for channels and classes, has as many parameters as the published networks:
PUBLISHED = {
    "ViT-B/16 without its head": (
        lambda: VisionTransformer(image_px=224, patch_px=16, channels=3, width=768, depth=12, heads=12, hidden=3072),
        85_798_656,
    ),
    "Swin-T without its head": (lambda: SwinTransformer(image_px=224, channels=3), 27_519_354),
    "UNet": (lambda: UNet(channels=1, classes=2), 31_030_658),
    "R50-ViT-B/16 TransUNet": (lambda: TransUnet(image_px=224, channels=3, classes=9), 105.28e6),
    "Swin-Unet": (lambda: SwinUnet(image_px=224, channels=3, classes=9), 27.17e6),
}


def count(network: torch.nn.Module) -> int:
    return sum(weight.numel() for weight in network.parameters())


@pytest.mark.parametrize("name", PUBLISHED)
def test_parameters_are_those_of_the_paper(name: str) -> None:
    build, published = PUBLISHED[name]
    with torch.device("meta"):  # counted, not filled
        found = count(build())
    assert found == published if isinstance(published, int) else abs(found - published) < 5e3


def test_thesis_sizes_are_the_published_ones() -> None:
    with torch.device("meta"):
        assert count(build_segmenter("unet", 512, **SEGMENTER_SIZES["unet"]["thesis"])) == 31_030_593
        transunet = build_segmenter("transunet", 224, **SEGMENTER_SIZES["transunet"]["thesis"])
        swinunet = build_segmenter("swinunet", 224, **SEGMENTER_SIZES["swinunet"]["thesis"])
        shape = build_shape_network(SHAPE_SIZES["thesis"], FORM, 150)
        fgrn = FGRN(points=100, **FGRN_SIZES["thesis"])
    assert segmentation_recipe("unet", "thesis").preprocessing.size_px == 512
    # one channel in, one logit out
    assert count(transunet) == 105_277_081 - 2 * 64 * 49 - 8 * (16 * 9 + 1)
    assert count(swinunet) == 27_168_900 - 2 * 96 * 16 - 8 * 96
    transformer = shape.features.transformer
    assert count(transformer) == 85_798_656 - 2 * 768 * 256
    projection = 768 * 512 + 512 + 512 * 512 + 512
    recurrent = 3 * (512 * 512 * 2 + 2 * 512)
    heads = sum(512 * 256 + 256 + 257 * outputs for outputs in (3, 2 * 149, 150))
    assert count(shape) == count(transformer) + projection + recurrent + heads
    convolutions = 320 + 32 * 64 * 9 + 64 + 64 * 128 * 9 + 128
    assert count(fgrn) == convolutions + 128 * 100 * 256 + 256 + 256 * 128 + 128 + 129 * 300


@pytest.mark.parametrize("name", SEGMENTERS)
def test_a_segmenter_gives_a_logit_a_pixel(name: str) -> None:
    network = build_segmenter(name, 64, **SEGMENTER_SIZES[name]["smoke"])
    logits = network(torch.rand(2, 1, 64, 64))
    assert logits.shape == (2, 1, 64, 64)
    logits.sum().backward()
    assert all(weight.grad is not None for weight in network.parameters())


@pytest.mark.parametrize("anchor", ["tip", "entry"])
@pytest.mark.parametrize("form", [FORM, None])
def test_shape_network_tells_a_curve_a_window(form: SphericalForm | None, anchor: str) -> None:
    network = build_shape_network(dataclasses.replace(SHAPE_SIZES["smoke"], anchor=anchor), form, 20).eval()
    clips = 255 * torch.rand(2, 6, 64, 64)
    shapes = network(clips)
    assert shapes.points_mm.shape == (8, 20, 3)
    assert shapes.stop_logits.shape == (8, 20)
    if anchor == "tip":
        assert torch.equal(shapes.points_mm[:, 0], shapes.tip_mm)
    # a window of a clip is seen as if it were alone
    alone = network(clips[1:, 2:5])
    assert torch.allclose(alone.points_mm[0], shapes.points_mm[6], atol=1e-4)
    ends = network.ends(shapes.stop_logits)
    curves = network.curves(clips[:, :3])
    assert [len(curve) for curve in curves] == (ends[[0, 4]] + 1).tolist()
    if form is not None and anchor == "tip":
        steps = shapes.points_mm.diff(dim=1).norm(dim=-1)
        assert torch.allclose(steps, torch.full_like(steps, 1.7), atol=1e-4)
    elif form is not None:  # led to the tip, wherever the curve is known to end
        known = torch.full((8,), 12)
        assert torch.allclose(network(clips, known).points_mm[:, 12], shapes.tip_mm, atol=1e-3)
        assert torch.allclose(curves[0][0], shapes.tip_mm[0], atol=1e-3)
    with pytest.raises(ValueError, match="at least 3 frames, got 2"):
        network(clips[:, :2])


def test_steps_have_the_radius_and_lie_on_the_curve() -> None:
    curve = wire(0.3, 10.0)
    walk = steps_of_radius(curve, 1.7)
    assert np.linalg.norm(np.diff(walk, axis=0), axis=1) == pytest.approx(1.7, abs=1e-3)
    dense = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(curve)])
    assert np.linalg.norm(walk[:, None] - dense[None], axis=-1).min(axis=1).max() < 0.05
    assert np.array_equal(walk[0], curve[0])
    with pytest.raises(ValueError, match="a curve of at least 500 mm"):
        steps_of_radius(curve, 500)


@pytest.mark.parametrize("cumulative", [False, True])
def test_angles_give_the_walk_again(cumulative: bool) -> None:
    walks = [steps_of_radius(wire(turn, 10.0), 2.0) for turn in np.linspace(-3, 3, 9)]  # all round
    form = SphericalForm.fit(walks, 2.0, cumulative=cumulative)
    for walk in walks[::2]:
        offsets = form.encode(walk)
        again = form.decode(torch.from_numpy(walk[0]), torch.from_numpy(offsets)).numpy()
        assert np.abs(again - walk).max() < 1e-3 * len(walk)
        steps = offsets if not cumulative else np.cumsum(offsets, axis=0)
        assert np.abs(np.diff(steps[:, 0])).max() < 0.5  # unwrapped along the curve


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
    sizes = {"patch_px": 8, "depth": 2, "heads": 2, "hidden": 32}
    return VisionTransformer(image_px=image_px, channels=channels, width=width, **sizes).eval()


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
    with pytest.raises(ValueError, match="no file of weights"):
        load_pretrained(network(), file)
    for content, said in (
        ({"layer.weight": torch.zeros(3)}, "weights of no vision transformer"),
        (renamed(network(width=8), TIMM), r"of another size: class_token should be \(1, 1, 16\)"),
        ([1, 2], "holds a list"),
    ):
        torch.save(content, file)
        with pytest.raises(ValueError, match=said):
            load_pretrained(network(), file)


def test_shifted_windows_keep_distant_tokens_apart() -> None:
    torch.manual_seed(0)
    block = SwinBlock(8, 2, window=4, grid=8, shifted=True)
    x = torch.randn(1, 8, 8, 8)
    changed = x.clone()
    changed[0, 0, 0, 0] += 3.0  # the corner shares its rolled window with the other corners
    moved = (block(changed) - block(x)).abs().sum(-1)[0] > 1e-6
    assert moved[:2, :2].all()
    assert not moved[2:].any()
    assert not moved[:, 2:].any()


def test_a_shifted_window_has_no_denormal_weight() -> None:
    """With one, a training step of SwinUnet takes half as long again."""
    mask = SwinBlock(16, 2, window=4, grid=8, shifted=True).mask
    assert mask is not None
    weights = torch.softmax(mask, dim=-1)
    assert ((weights == 0) | (weights > torch.finfo(torch.float32).tiny)).all()
    assert (weights == 0).any()
