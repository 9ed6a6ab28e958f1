"""Lines of a picture: local contrast and thin dark lines, which is what a wire looks like, at several resolutions."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from splineformer.modeling.convolutions import box_means, scaled

CHANNELS = 2
_COARSE = 8  # px whose mean is what local contrast is measured against
_FLOOR = 0.25  # grey levels: an even picture's noise is not blown up further
_WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))


def local_contrast(image: Tensor) -> Tensor:
    """(B, 1, h, w) grey levels minus their local mean, in units of the picture's own detail."""
    coarse = box_means(F.avg_pool2d(image, _COARSE), 3)
    around = F.interpolate(coarse, image.shape[-2:], mode="bilinear", align_corners=False)
    return scaled(image - around, _FLOOR)


def dark_lines(image: Tensor, reach: int) -> Tensor:
    """How much darker each pixel is than what lies to both sides of it, in the direction where that is most.

    Edges are no lines: on one side of an edge it is dark.

    Args:
        image: (B, 1, h, w) grey levels.
        reach: px to each side.

    Returns:
        (B, 1, h, w), at least 0, in units of the picture's own lines.
    """
    height, width = image.shape[-2:]
    wide = F.pad(image, (reach,) * 4, mode="replicate")

    def moved(down: int, right: int) -> Tensor:
        top, left = reach + reach * down, reach + reach * right
        return wide[..., top : top + height, left : left + width]

    darker = image  # at least: what is no line is 0
    for down, right in _WAYS:
        darker = torch.maximum(darker, torch.minimum(moved(down, right), moved(-down, -right)))
    return scaled(darker - image, _FLOOR)


def _strongest_of_four(x: Tensor) -> Tensor:
    """What max pooling by 2 gives of (B, C, h, w), h and w even, in a tenth of its time on a processor."""
    x = torch.maximum(x[..., ::2, :], x[..., 1::2, :])
    return torch.maximum(x[..., ::2], x[..., 1::2])


def line_pyramid(image: Tensor, reach: int, levels: int) -> list[Tensor]:
    """Contrast and lines at the picture's resolution, at half of it, and so on.

    Args:
        image: (B, 1, h, w) grey levels of 0 to 255.
        reach: see `dark_lines`.
        levels: how many.

    Returns:
        (B, 2, h / 2^k, w / 2^k) each; contrast is averaged on the way, of lines the strongest stay.
    """
    contrast, lines = local_contrast(image), dark_lines(image, reach)
    found = [torch.cat([contrast, lines], 1)]
    for _ in range(levels - 1):
        contrast, lines = F.avg_pool2d(contrast, 2), _strongest_of_four(lines)
        found.append(torch.cat([contrast, lines], 1))
    return found
