"""Reader network: shapes, an input that forgets the exposure, and normalisations that are part of the convolutions."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from guide3d.modeling.reader_network import ReaderNetwork, reader_input, without_normalisation


@pytest.mark.parametrize(("block_px", "widths"), [(4, (8, 12, 16)), (2, (8, 8, 8, 8))])
def test_shapes(block_px: int, widths: tuple[int, ...]) -> None:
    network = ReaderNetwork(block_px=block_px, widths=widths).eval()
    assert network.multiple_px == 16
    assert network(torch.zeros(2, 2, 32, 48)).shape == (2, 3, 32, 48)


def test_an_untrained_network_says_nothing() -> None:
    chance = ReaderNetwork(widths=(8, 8)).eval()(torch.zeros(1, 2, 16, 16)).sigmoid()
    assert chance.max() < 0.2


def test_fused_normalisation_changes_nothing() -> None:
    torch.manual_seed(0)
    network = ReaderNetwork(widths=(8, 12, 16))
    images = torch.randn(4, 2, 32, 32)
    network(images)  # fills the running means
    network.eval()
    fused = without_normalisation(network)
    assert sum(isinstance(module, torch.nn.BatchNorm2d) for module in fused.modules()) == 0
    with torch.no_grad():
        torch.testing.assert_close(fused(images), network(images), rtol=1e-4, atol=1e-4)


def test_the_first_channel_does_not_depend_on_the_exposure() -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(0.5, 1.0, (96, 96))
    bright, dark = (reader_input((gain * image).astype(np.uint8)) for gain in (250.0, 125.0))
    assert bright.shape == (2, 96, 96)
    assert np.abs(bright[0] - dark[0]).mean() < 0.05
    assert abs((bright[1] - dark[1]).mean() - 0.8 * np.log(2)) < 0.05
