"""Sizes of the networks: `thesis` as published, `desk` for a processor in minutes, `smoke` to prove the plumbing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import nn

from guide3d.modeling.pretrained import load_pretrained
from guide3d.modeling.shape_network import ImageFeatures, ShapeNetwork
from guide3d.modeling.spherical import SphericalForm
from guide3d.modeling.swin_transformer import SwinUnet
from guide3d.modeling.transunet import TransUnet
from guide3d.modeling.unet import UNet
from guide3d.modeling.vision_transformer import VisionTransformer
from guide3d.setting_kinds import Dropout, Layers, Pixels, Units, UnitsOrNone, settings

SIZES = ("thesis", "desk", "smoke")
SEGMENTERS = ("unet", "transunet", "swinunet")


@settings
class ShapeSize:
    """Sizes of the shape network; `thesis` is ViT-B/16 and what the thesis says of the rest.

    `kept`: numbers that pooling "tokens" keeps of each token; `anchor`: see `modeling.shape_network.ANCHORS`.
    """

    image_px: Pixels = 224
    patch_px: Pixels = 16
    width: Units = 768
    depth: Layers = 12
    heads: Units = 12
    hidden: Units = 3072
    stem: tuple[Units, ...] = ()
    pooling: str = "class"
    kept: UnitsOrNone = 0
    anchor: str = "tip"
    features: Units = 512
    state: Units = 512
    head: Units = 256
    frames: Layers = 3
    dropout: Dropout = 0.1


SHAPE_SIZES: dict[str, ShapeSize] = {
    "thesis": ShapeSize(),
    "desk": ShapeSize(
        image_px=128, width=96, depth=2, heads=4, hidden=192, stem=(16, 24, 32, 64), pooling="tokens", kept=24,
        anchor="entry", features=512, state=256, head=256, dropout=0.0,
    ),
    "smoke": ShapeSize(
        image_px=64, width=32, depth=1, heads=2, hidden=64, stem=(8, 8, 16, 16), pooling="tokens", kept=8,
        anchor="entry", features=32, state=32, head=32,
    ),
}  # fmt: skip

FGRN_SIZES: dict[str, dict[str, Any]] = {
    "thesis": {"image_px": 80, "filters": (32, 64, 128), "hidden": (256, 128), "dropout": 0.3},
    "desk": {"image_px": 80, "filters": (32, 64, 128), "hidden": (256, 128), "dropout": 0.3},
    "smoke": {"image_px": 80, "filters": (8, 8, 16), "hidden": (32, 32), "dropout": 0.3},
}

SEGMENTER_SIZES: dict[str, dict[str, dict[str, Any]]] = {
    "unet": {
        "thesis": {"widths": (64, 128, 256, 512, 1024), "kind": "none"},
        "desk": {"widths": (8, 16, 32, 64), "kind": "batch"},
        "smoke": {"widths": (4, 8), "kind": "batch"},
    },
    "transunet": {
        "thesis": {},
        "desk": {
            "residual_width": 16, "residual_units": (1, 1, 1), "width": 128, "depth": 2, "heads": 4, "hidden": 256,
            "dropout": 0.0, "neck": 64, "decoder": (48, 32, 16, 8),
        },
        "smoke": {
            "residual_width": 4, "residual_units": (1, 1, 1), "width": 16, "depth": 1, "heads": 2, "hidden": 16,
            "neck": 8, "decoder": (8, 8, 4, 4),
        },
    },
    "swinunet": {
        "thesis": {},
        "desk": {"patch_px": 4, "width": 48, "depths": (2, 2, 2), "heads": (2, 4, 8), "window": 8},
        "smoke": {"patch_px": 4, "width": 8, "depths": (1, 1), "heads": (1, 2), "window": 8},
    },
}  # fmt: skip


def build_shape_network(
    size: ShapeSize, form: SphericalForm | None, positions: int, *, pretrained: Path | str | None = None
) -> ShapeNetwork:
    """Builds the shape network.

    Args:
        form: of the curve; None: the Cartesian twin.
        positions: M, points of the longest curve.
        pretrained: weights of the vision transformer, if there are any.

    Raises:
        FileNotFoundError, ValueError: the pretrained weights are missing or do not fit.
    """
    transformer = VisionTransformer(
        image_px=size.image_px, patch_px=size.patch_px, channels=1, width=size.width, depth=size.depth,
        heads=size.heads, hidden=size.hidden, dropout=size.dropout, stem=tuple(size.stem),
    )  # fmt: skip
    if pretrained is not None:
        load_pretrained(transformer, pretrained)
    features = ImageFeatures(transformer, size.width, size.features, size.pooling, size.dropout, size.kept)
    return ShapeNetwork(
        features, form, positions=positions, size=size.features, frames=size.frames, state=size.state,
        hidden=size.head, dropout=size.dropout, anchor=size.anchor,
    )  # fmt: skip


def build_segmenter(name: str, image_px: int, **sizes: Any) -> nn.Module:
    """Builds a segmentation network ("unet", "transunet", "swinunet"): one channel in, one logit a pixel out.

    Raises:
        ValueError: an unknown name, or sizes that the network does not have.
    """
    if name not in SEGMENTERS:
        raise ValueError(f"unknown segmentation network '{name}'; there are {', '.join(SEGMENTERS)}")
    try:
        if name == "unet":
            return UNet(**sizes)
        return (TransUnet if name == "transunet" else SwinUnet)(image_px=image_px, **sizes)
    except TypeError as error:
        raise ValueError(f"{name} cannot have the sizes {sizes}: {error}") from error


def to_spec(size: ShapeSize, form: SphericalForm | None, positions: int) -> dict[str, Any]:
    """What a model file keeps to build a shape network again: see `from_spec`."""
    return {"size": asdict(size), "form": None if form is None else asdict(form), "positions": positions}


def from_spec(description: Mapping[str, Any]) -> ShapeNetwork:
    """Builds a shape network from what `to_spec` gave."""
    form = None if description["form"] is None else SphericalForm(**description["form"])
    return build_shape_network(ShapeSize(**description["size"]), form, description["positions"])
