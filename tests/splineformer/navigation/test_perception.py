"""The perception network: what it reads is what the predictor reads, and its weights stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splineformer.build import VARIANTS, build, size_of
from splineformer.image_input import picture_of
from splineformer.navigation.perception import PerceptionNetwork
from splineformer.predictor import Predictor
from tests.splineformer.curves import image_of, wavy_wire
from tests.splineformer.navigation.drawn_moments import perception_network


@pytest.mark.parametrize("variant", VARIANTS)
def test_reading_is_that_of_the_predictor(variant: str) -> None:
    network = perception_network(variant)
    images = [image_of(wavy_wire(seed)) for seed in (0, 1)]
    readings = network(images)
    assert len(readings) == 2
    for reading, predicted in zip(readings, network.predictor.batch(images), strict=True):
        assert reading.tokens.shape == (network.tokens, 3)
        assert reading.encoded.shape == (network.encoded,)
        assert 0 <= reading.confidence <= 1
        assert np.allclose(reading.tokens[-1, 0], 1.0, atol=1e-5)  # knots are shares of the length
        if predicted.tokens is not None and not predicted.inverted:
            assert np.allclose(256 * reading.points[0] - 0.5, predicted.tip_px, atol=1e-2)


@pytest.mark.parametrize("variant", VARIANTS)
def test_encoded_is_the_output_of_the_encoder(variant: str) -> None:
    network = perception_network(variant)
    image = image_of(wavy_wire(0))
    reading = network([image])[0]
    levels = torch.from_numpy(picture_of(image, 64, 256).pixels.astype(np.float32))[None, None]
    with torch.no_grad():
        memory = network.network.read(levels).features
    assert np.allclose(reading.encoded[: len(reading.encoded) // 2], memory[0].mean(0).numpy(), atol=1e-5)
    assert not network.network.training


def test_a_network_of_maps_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a network that reads grey levels, got one that reads maps"):
        PerceptionNetwork(Predictor(build(size_of("ordered", "smoke")), source_px=256, input="maps"))
