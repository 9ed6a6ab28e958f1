"""Reader network: a small U-Net that marks wire, catheter and tip in an X-ray image of any grey values.

It works on blocks of `block_px` x `block_px` pixels as channels, so that its finest level has few pixels; its output
has the image's resolution. Its two inputs (`reader_input`) come from the logarithm of the grey values, in which what
lies one behind the other adds up, and a factor of the exposure is a constant.

Source: Ronneberger et al., U-Net, 2015; blocks as channels: Shi et al., Real-time single image super-resolution using
an efficient sub-pixel convolutional neural network, 2016.
"""

from __future__ import annotations

import copy
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from guide3d.opencv import cv2

CLASSES = ("wire", "catheter", "tip")
INPUTS = 2

_LOCAL_SIGMA_PX = 10.0
_LOCAL_GAIN, _GREY_GAIN, _MIDDLE = 5.0, 0.8, 4.0  # of the differences, of the grey values; a middling logarithm
_LOG = np.log1p(np.arange(256, dtype=np.float32))


def reader_input(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The network's input (2, h, w) of an image (h, w) uint8.

    The first channel is the logarithm of the grey values less its mean over a Gaussian of 10 px, the second the
    logarithm itself.
    """
    logarithm = cv2.LUT(image, _LOG)
    height, width = image.shape
    small = cv2.resize(logarithm, (-(-width // 4), -(-height // 4)), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), _LOCAL_SIGMA_PX / 4, borderType=cv2.BORDER_REFLECT)
    mean = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    channels = np.empty((INPUTS, height, width), np.float32)
    np.subtract(logarithm, mean, out=channels[0])
    channels[0] *= _LOCAL_GAIN
    np.subtract(logarithm, _MIDDLE, out=channels[1])
    channels[1] *= _GREY_GAIN
    return channels


class Convolution(nn.Module):
    """A 3 x 3 convolution, batch normalisation and a rectifier."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.convolution: nn.Module = nn.Conv2d(before, after, 3, padding=1, bias=False)
        self.normalisation: nn.Module = nn.BatchNorm2d(after)

    def forward(self, x: Tensor) -> Tensor:
        """(batch, before, h, w) to (batch, after, h, w)."""
        result: Tensor = functional.relu(self.normalisation(self.convolution(x)), inplace=True)
        return result


class ReaderNetwork(nn.Module):
    """Images to logits of wire, catheter and tip."""

    def __init__(self, *, block_px: int = 2, widths: tuple[int, ...] = (16, 32, 64, 96, 96)) -> None:
        """Args:
        block_px: side of the blocks of pixels that become channels.
        widths: channels of the levels, the finest first.
        """
        super().__init__()
        self.block_px, self.widths = block_px, tuple(widths)
        self.multiple_px = block_px * 2 ** (len(widths) - 1)
        pixels = block_px * block_px
        self.first = Convolution(INPUTS * pixels, widths[0])
        pairs = list(pairwise(widths))
        self.down = nn.ModuleList(
            nn.Sequential(Convolution(fine, coarse), Convolution(coarse, coarse)) for fine, coarse in pairs
        )
        self.fine = Convolution(widths[0], widths[0])
        self.across = nn.ModuleList(nn.Conv2d(coarse, fine, 1) for fine, coarse in pairs)
        self.join = nn.ModuleList(
            nn.Sequential(Convolution(2 * fine, fine), Convolution(fine, fine)) for fine, _ in pairs
        )
        self.head = nn.Conv2d(widths[0], len(CLASSES) * pixels, 1)
        with torch.no_grad():  # most pixels are none of the three
            assert self.head.bias is not None
            self.head.bias.fill_(-4.0)

    def forward(self, x: Tensor) -> Tensor:
        """(batch, 2, h, w) of `reader_input` to (batch, 3, h, w); h and w multiples of `multiple_px`."""
        x = self.fine(self.first(functional.pixel_unshuffle(x, self.block_px)))
        passed = [x]
        for down in self.down:
            x = down(functional.max_pool2d(x, 2))
            passed.append(x)
        for across, join, finer in reversed(list(zip(self.across, self.join, passed[:-1], strict=True))):
            x = functional.interpolate(across(x), scale_factor=2, mode="nearest")
            x = join(torch.cat((finer, x), dim=1))
        return functional.pixel_shuffle(self.head(x), self.block_px)


def without_normalisation(network: ReaderNetwork) -> ReaderNetwork:
    """A copy, for evaluation only, whose normalisations are part of the convolutions before them."""
    result = copy.deepcopy(network).eval()
    for module in result.modules():
        if isinstance(module, Convolution):
            fused: Any = fuse_conv_bn_eval(module.convolution, module.normalisation)  # type: ignore[type-var,arg-type]
            module.convolution, module.normalisation = fused, nn.Identity()
    return result
