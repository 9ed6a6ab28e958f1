"""Positions, attention and its weights."""

from __future__ import annotations

import pytest
import torch

from splineformer.modeling.transformer import Attention, DecoderLayer, LayerCache, grid_positions, sequence_positions


def test_positions() -> None:
    assert sequence_positions(5, 8).shape == (5, 8)
    grid = grid_positions(4, 16)
    assert grid.shape == (16, 16)
    assert len(torch.unique(grid, dim=0)) == 16
    with pytest.raises(ValueError, match="multiple of 4"):
        grid_positions(4, 6)


def test_positions_are_sines_and_cosines() -> None:
    positions = sequence_positions(3, 4)
    assert torch.allclose(positions[0], torch.tensor([0.0, 1.0, 0.0, 1.0]))
    angles = torch.tensor([2.0, 2.0 / 100.0])  # place 2; wavelengths of 2 pi and 200 pi
    assert torch.allclose(positions[2], torch.stack([angles.sin(), angles.cos()], -1).flatten())


def test_attention_answers_with_the_weights_it_gives() -> None:
    torch.manual_seed(0)
    attention, x, source = Attention(8, 2), torch.rand(2, 3, 8), torch.rand(2, 5, 8)
    keys_values = attention.keys_values(source)
    weights = attention.weights(x, keys_values)
    assert weights.shape == (2, 2, 3, 5)
    assert torch.allclose(weights.sum(-1), torch.ones(2, 2, 3))
    answer = attention.out((weights @ keys_values[1]).transpose(1, 2).flatten(2))
    assert torch.allclose(answer, attention(x, keys_values), atol=1e-6)
    with pytest.raises(ValueError, match="heads must divide the width, got 3 and 8"):
        Attention(8, 3)


def test_steps_of_a_decoder_layer_are_its_forward_pass() -> None:
    torch.manual_seed(0)
    layer, x = DecoderLayer(8, 2).eval(), torch.rand(2, 4, 8)
    features = layer.cross_attention.keys_values(torch.rand(2, 5, 8))
    cache, attended = LayerCache(features), []
    steps = torch.cat([layer.step(x[:, k : k + 1], cache, attended) for k in range(4)], 1)
    assert torch.allclose(steps, layer(x, features), atol=1e-6)
    assert not torch.allclose(steps, layer(x, features, causal=False), atol=1e-3)
    assert [tuple(one.shape) for one in attended] == [(2, 2, 5)] * 4
