"""Attention maps: where in the image the decoder looks, heads fused by their maximum, faint attention discarded."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn import functional as F

from splineformer.predictor import Predictor

DISCARD = 0.65


def fused(weights: Tensor, discard: float = DISCARD) -> Tensor:
    """Maximal fusion of attention.

    Args:
        weights: (heads, tokens, N) attention of the last decoder layer over N = side² cells, row by row.
        discard: values below this share of the greatest are taken as 0.

    Returns:
        (side, side) in 0 to 1: the greatest over the tokens, each head brought to 0 to 1, the greatest over the heads.

    Raises:
        ValueError: a share outside 0 to 1, or cells that make no square.
    """
    if not 0 <= discard < 1:
        raise ValueError(f"discard: expected 0 to below 1, got {discard}")
    side = round(weights.shape[-1] ** 0.5)
    if weights.ndim != 3 or side * side != weights.shape[-1]:
        raise ValueError(f"weights: expected (heads, tokens, side²), got {tuple(weights.shape)}")
    head = weights.amax(dim=1)
    low, high = head.amin(dim=1, keepdim=True), head.amax(dim=1, keepdim=True)
    together = ((head - low) / (high - low).clamp_min(1e-12)).amax(dim=0)
    return torch.where(together < discard * together.max(), 0.0, together).unflatten(0, (side, side))


def attention_map(predictor: Predictor, image: ArrayLike, discard: float = DISCARD) -> NDArray[np.float32]:
    """Where the network looks in (h, w) grey levels: (h, w) in 0 to 1, enlarged bilinearly; `discard` as in `fused`.

    It is given what the predictor gives it of the image: grey levels, or the reader's maps, unturned.

    Raises:
        ValueError: no image.
    """
    network = predictor.network
    network.eval()
    shape = np.shape(image)[:2]
    picture = predictor.picture(image)
    levels = torch.from_numpy(picture.pixels.astype(np.float32))[None, None]
    weights, lengths = network.attention(levels.to(next(network.parameters()).device))
    small = fused(weights[0, :, : int(lengths[0])], discard)
    side = int(picture.side_px)
    large = F.interpolate(small[None, None], (side, side), mode="bilinear", align_corners=False)[0, 0]
    return large[: shape[0], : shape[1]].cpu().numpy()
