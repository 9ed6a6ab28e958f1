"""Networks of policies: extractors of the thesis's tables."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import yaml

from enn.imitation.cloned_policy import CloningNetwork, CloningNetworkSettings
from enn.networks.features import MultimodalExtractor, layer_table, thesis_cnn, thesis_mlp

PICTURE = gymnasium.spaces.Box(0, 255, (1, 80, 80), np.uint8)
SPACE = gymnasium.spaces.Dict(
    {
        "joints": gymnasium.spaces.Box(-np.inf, np.inf, (336,), np.float32),
        "image": PICTURE,
        "mask": PICTURE,
        "roadmap": gymnasium.spaces.Box(-np.inf, np.inf, (71,), np.float32),
        "history": gymnasium.spaces.Box(-np.inf, np.inf, (18,), np.float32),
        "internal": gymnasium.spaces.Box(-np.inf, np.inf, (40,), np.float32),
        "sequential": gymnasium.spaces.Box(0, 255, (3, 128, 128), np.uint8),
    }
)
TABLES = Path(__file__).parents[3] / "pipeline" / "report" / "thesis.yaml"


def thesis_rows(table: str) -> dict[str, list]:
    return yaml.safe_load(TABLES.read_text())["tables"][table]["rows"]


def test_the_enn_networks_reproduce_the_thesis_table() -> None:
    cnn, mlp = layer_table(thesis_cnn((1, 80, 80)), (1, 80, 80)), layer_table(thesis_mlp(336), (336,))
    measured = {f"cnn/{name}": row for name, row in cnn.items()} | {f"mlp/{name}": row for name, row in mlp.items()}
    assert measured == thesis_rows("architecture_params")
    assert [row[1] for row in cnn.values()] == [0, 2080, 32832, 36928, 0, 590080, 32896]
    assert [row[1] for row in mlp.values()] == [0, 86272, 32896]
    inside = layer_table(MultimodalExtractor(SPACE, ("joints",)).networks["joints"], (336,))
    assert [row[1] for row in inside.values()] == [0, 86272, 32896]


def test_the_cloning_network_reproduces_the_thesis_table() -> None:
    rows = layer_table(CloningNetwork(CloningNetworkSettings(variant="thesis")).layers(), (1, 80, 80))
    assert rows == thesis_rows("bc_architecture")
    assert rows["linear_3"] == ["2", 258, "none", None, None, None]


def test_bad_arguments_are_refused() -> None:
    picture: Any = PICTURE
    refusals: list[tuple[Callable[[], object], str]] = [
        (lambda: MultimodalExtractor(SPACE, variant="lab"), "unknown variant 'lab'; there are thesis, desk"),
        (lambda: MultimodalExtractor(SPACE, ("image", "tip")), "wants 'tip', but the observation has history, image"),
        (lambda: MultimodalExtractor(SPACE, ("image",), image_features=64), r"128 .* or 256 .*, got 64"),
        (lambda: MultimodalExtractor(picture, ("image",)), "expected a Dict observation"),
        (lambda: thesis_cnn((1, 20, 20)), r"\(1, 20, 20\) are too small"),
    ]
    for call, said in refusals:
        with pytest.raises(ValueError, match=said):
            call()
