"""Features: the thesis's tables from the networks themselves, modality sets, fusion."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
import yaml

from enn.imitation.cloned_policy import CloningNetwork, CloningNetworkSettings
from enn.networks.features import (
    MultimodalExtractor,
    layer_table,
    modality_keys,
    nature_cnn,
    thesis_cnn,
    thesis_mlp,
)

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


def batch(keys: tuple[str, ...], rows: int = 2) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    return {key: torch.rand((rows, *SPACE[key].shape), generator=generator) for key in keys}


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


@pytest.mark.parametrize(
    ("modalities", "keys"),
    [
        ("I", ("joints",)),
        ("V+M", ("image", "mask")),
        ("I+V+M", ("joints", "image", "mask")),
        ("R", ("roadmap", "history")),
        ("sequential", ("sequential",)),
    ],
)
def test_modality_sets_name_observations(modalities: str, keys: tuple[str, ...]) -> None:
    assert modality_keys(modalities) == keys


@pytest.mark.parametrize("wrong", ["", "M+V", "I+X", "joints"])
def test_an_unknown_modality_set_is_refused_with_the_valid_ones(wrong: str) -> None:
    with pytest.raises(ValueError, match=r"I, V, M, I\+V, I\+M, V\+M, I\+V\+M, R, internal, image, sequential"):
        modality_keys(wrong)


@pytest.mark.parametrize("variant", ["thesis", "desk"])
@pytest.mark.parametrize("modalities", ["I", "V+M", "I+V+M", "R", "sequential"])
def test_every_set_gives_a_compact_vector(variant: str, modalities: str) -> None:
    keys = modality_keys(modalities)
    extractor = MultimodalExtractor(SPACE, keys, variant)
    features = extractor(batch(keys))
    assert features.shape == (2, extractor.features_dim) == (2, 128)
    assert not torch.equal(features[0], features[1])


def test_the_text_has_more_image_features_than_the_table() -> None:
    table = MultimodalExtractor(SPACE, ("joints", "image", "mask"))
    text = MultimodalExtractor(SPACE, ("joints", "image", "mask"), image_features=256)
    assert (table.fusion[0].in_features, text.fusion[0].in_features) == (3 * 128, 2 * 256 + 128)
    assert "linear_2" not in layer_table(text.networks["image"], (1, 80, 80))


def test_the_desk_variant_sees_image_and_mask_as_channels_of_one_cnn() -> None:
    extractor = MultimodalExtractor(SPACE, ("joints", "image", "mask"), "desk")
    assert set(extractor.networks) == {"joints", "image"}
    assert extractor.networks["image"][0].in_channels == 2
    seen = batch(("joints", "image", "mask"))
    assert not torch.allclose(extractor(seen), extractor(seen | {"mask": 1 - seen["mask"]}))


def test_the_baselines_have_no_fusion() -> None:
    assert MultimodalExtractor(SPACE, ("sequential",), "baselines").features_dim == 512
    internal = MultimodalExtractor(SPACE, ("internal",), "baselines")
    seen = batch(("internal",))
    assert torch.equal(internal(seen), seen["internal"])
    table = layer_table(nature_cnn((3, 128, 128)), (3, 128, 128))
    assert table["linear_1"][0] == "512"
    assert table["conv_1"][1] == 3 * 32 * 64 + 32


def test_gradients_reach_every_modality() -> None:
    keys = ("joints", "image", "mask")
    for variant in ("thesis", "desk"):
        extractor = MultimodalExtractor(SPACE, keys, variant)
        extractor(batch(keys, 8)).square().sum().backward()
        assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in extractor.parameters())


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown variant 'lab'; there are thesis, desk"):
        MultimodalExtractor(SPACE, variant="lab")
    with pytest.raises(ValueError, match="wants 'tip', but the observation has history, image"):
        MultimodalExtractor(SPACE, ("image", "tip"))
    with pytest.raises(ValueError, match=r"128 .* or 256 .*, got 64"):
        MultimodalExtractor(SPACE, ("image",), image_features=64)
    with pytest.raises(ValueError, match="expected a Dict observation"):
        MultimodalExtractor(PICTURE, ("image",))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"\(1, 20, 20\) are too small"):
        thesis_cnn((1, 20, 20))
