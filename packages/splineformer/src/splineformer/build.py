"""Sizes of the networks: `thesis` as published, `desk` for minutes on a processor, `smoke` for tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from splineformer.modeling.curve_network import CurveNetwork
from splineformer.modeling.ordered import OrderedSettings, OrderedSplineFormer
from splineformer.modeling.published import SplineFormer, SplineFormerSettings

VARIANTS = ("published", "ordered")
LAYOUT = 2  # of what model files keep; a change of the networks that old weights do not fit raises it

_NETWORKS: dict[Any, Any] = {SplineFormerSettings: SplineFormer, OrderedSettings: OrderedSplineFormer}

SIZES: dict[str, dict[str, SplineFormerSettings | OrderedSettings]] = {
    "published": {
        "thesis": SplineFormerSettings(image_px=1024, line_px=6),
        "thesis_large": SplineFormerSettings(image_px=1024, line_px=6, width=512, encoder_layers=10, decoder_layers=10),
        "desk": SplineFormerSettings(
            image_px=256, line_px=2, patch_px=32, width=96, heads=4, encoder_layers=4, decoder_layers=3, limit=16,
            dropout=0.0, tip_px=128,
        ),
        "smoke": SplineFormerSettings(
            image_px=64, line_px=1, patch_px=16, width=32, heads=2, encoder_layers=1, decoder_layers=1, dropout=0.0
        ),
    },
    "ordered": {
        "thesis": OrderedSettings(
            image_px=512, line_px=4, channels=(32, 64, 128, 256), blocks=(1, 1, 1, 1), width=256, heads=8,
            encoder_layers=6, decoder_layers=3, hidden=(1024, 512), steps=80, queries=64, tip_channels=32,
            revision_cells=(16.0, 8.0), revision_layers=2, cells=(4.0, 2.0, 1.0, 0.5),
            refinement_width=128,
        ),
        "desk": OrderedSettings(),
        "smoke": OrderedSettings(
            image_px=64, overview_level=0, line_px=1, channels=(4, 8, 8, 16), width=16, heads=2, encoder_layers=1,
            kept=8, hidden=(32, 32), steps=20, queries=24, control_points=10, tip_channels=4, revision_cells=(4.0,),
            cells=(2.0, 1.0), reach=2, refinement_width=16,
        ),
    },
}  # fmt: skip


def size_of(variant: str, size: str) -> SplineFormerSettings | OrderedSettings:
    """The settings of a variant at a size.

    Raises:
        ValueError: an unknown variant or size; the message lists the valid ones.
    """
    if variant not in SIZES:
        raise ValueError(f"unknown variant '{variant}'; there are {', '.join(VARIANTS)}")
    if size not in SIZES[variant]:
        raise ValueError(f"unknown size '{size}' of variant {variant}; there are {', '.join(SIZES[variant])}")
    return SIZES[variant][size]


def build(settings: SplineFormerSettings | OrderedSettings) -> CurveNetwork:
    """Builds the network that settings describe."""
    network: CurveNetwork = _NETWORKS[type(settings)](settings)
    return network


def to_spec(network: CurveNetwork) -> dict[str, Any]:
    """What a model file keeps to build the network again: see `from_spec`."""
    settings = {
        key: list(value) if isinstance(value, tuple) else value for key, value in asdict(network.settings).items()
    }
    return {"layout": LAYOUT, "variant": network.variant, "settings": settings}


def from_spec(description: Mapping[str, Any]) -> CurveNetwork:
    """Builds a network, its weights still to be filled in, from what `to_spec` gave.

    Raises:
        ValueError: another layout or variant, or settings of another version.
    """
    if description.get("layout") != LAYOUT:
        raise ValueError(
            f"the network has layout {description.get('layout')}, this version reads {LAYOUT}: train it again, or "
            "take the version that wrote it"
        )
    classes = {network.variant: settings for settings, network in _NETWORKS.items()}
    variant = description.get("variant")
    if variant not in classes:
        raise ValueError(f"unknown variant '{variant}'; there are {', '.join(VARIANTS)}")
    sizes = {key: tuple(value) if isinstance(value, list) else value for key, value in description["settings"].items()}
    try:
        return build(classes[variant](**sizes))
    except (TypeError, ValueError) as error:
        raise ValueError(f"the network's settings are of another version ({error}): train it again") from error
