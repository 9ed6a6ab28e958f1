"""Lines of a picture: lines and edges, brightness, resolutions."""

from __future__ import annotations

import numpy as np
import torch

from splineformer.modeling.convolutions import dark_lines, line_pyramid, local_contrast
from tests.splineformer.curves import image_of, wavy_wire


def levels(count: int, side: int) -> torch.Tensor:
    return torch.from_numpy(np.stack([image_of(wavy_wire(k, side), side, k) for k in range(count)]))[:, None].float()


def test_lines_are_told_from_edges() -> None:
    image = torch.full((1, 1, 64, 64), 120.0)
    image[..., 40:] = 60.0  # an edge
    image[0, 0, 30, :30] -= 20.0  # a line
    image[0, 0, :20, 10] += 20.0  # a bright one
    lines = dark_lines(image, 2)[0, 0]
    assert (lines[30, 3:28] > 1).all()
    lines[29:32] = 0
    assert lines[:, 5:].abs().max() < 0.1 * lines[30].max().clamp_min(1)
    # neither brightness nor contrast matters, as long as there is more than the floor
    assert torch.allclose(dark_lines(0.5 * image + 40, 2), dark_lines(image, 2), atol=1e-4)
    assert torch.allclose(local_contrast(0.5 * image + 40), local_contrast(image), atol=1e-4)


def test_pyramid_keeps_lines_on_its_way_down() -> None:
    image = levels(1, 64)
    pyramid = line_pyramid(image, 2, 3)
    assert [tuple(maps.shape) for maps in pyramid] == [(1, 2, 64, 64), (1, 2, 32, 32), (1, 2, 16, 16)]
    assert pyramid[2][:, 1].max() == pyramid[0][:, 1].max()
    assert torch.allclose(pyramid[2][:, 0].mean(), pyramid[0][:, 0].mean(), atol=1e-5)
