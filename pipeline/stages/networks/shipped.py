"""Networks that come with a package: where a stage would only repeat the training of one, it may take that one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.settings.kinds import settings_that_matter
from pipeline.stages import StageContext
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.stages.networks.settings import SHIPPED, ShippedSettings
from pipeline.store.manifest import read_manifest
from pipeline.tables import Results


def shipped_rows(settings: ShippedSettings, context: StageContext) -> dict[str, str]:
    """Row to shipped network, of those that a training here would repeat: data set, size, split and seed agree."""
    data = read_manifest(context.inputs["guide3d"])
    same = (settings.size, settings.epochs, settings.split_seed, context.seed) == ("desk", 0, 0, 0)
    if not (settings.shipped and same and data is not None):
        return {}
    _, row, name = SHIPPED[settings.name]
    usual = settings_that_matter(Guide3dSettings())
    return {row: name} if {key: data.config.get(key) for key in usual} == usual else {}


def noted(results: Results, taken: Mapping[str, str], labels: Mapping[str, str], package: str) -> dict[str, Any]:
    """Table to the note of which of the labelled rows are networks that were taken; none where none was."""
    text = " ".join(
        f"{labels[row]}: `{name}`, shipped with the package, its training not repeated here. Its card "
        f"(`{package}.card`) has the command of the training; `make all PRETRAINED=0` trains."
        for row, name in taken.items()
        if row in labels
    )
    return dict.fromkeys(results.tables, text) if text else {}
