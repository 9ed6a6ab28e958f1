"""Wire segmentation: which pixels of a noisy fluoroscopic image show the guidewire, by a small network.

It sees how much darker the image is than one taken before the wire came in, so that only wire and noise are left. A
wire takes a share of the light, so that it is faint where little comes through the body: there it is enhanced, as far
as the noise allows.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from enn.fitting import CHANNELS_FIRST, CHANNELS_LAST
from enn.imitation.dagger import PerturbedController
from enn.networks.devices import bfloat16_on_processor, device_of
from enn.policy import Policy

_BATCH, _LEARNING_RATE = 8, 5e-3  # images an update; of Adam at its largest: it rises first and falls to nothing

Network = TypeVar("Network", bound=nn.Module)


DARKENING = 10.0  # grey levels that count as one
BRIGHT = 130.0  # grey levels from which on a difference counts as it is; darker ones are enhanced
NOISE = 2.0  # grey levels, standard deviation of the noise of a difference beyond which nothing is enhanced
_MOST = 4.0  # times that a difference is enhanced, however little noise there is
_LIT = 24  # grey levels of the darkest pixels whose noise counts; outside the field there is none
_DILATIONS = (2, 4, 8)
_CROP = 96  # px, side of what an update sees of an image
_LEAST, _GAP = 0.2, 2  # a thin tip is doubtful, and a wire that is cut in two is worse than one too wide; px
_RARE = -3.0  # logit of a pixel before training: few show the wire
BETWEEN = 8  # steps between two images of an episode
_ON_WIRE = 0.8  # share of the crops with a part of the wire in their middle third


def fitted(
    make: Callable[[], Network],
    count: int,
    loss_of: Callable[[Network, NDArray[np.intp], np.random.Generator], Tensor],
    *,
    epochs: int,
    seed: int,
    progress: Callable[[int, float], None] | None,
    device: torch.device | str,
) -> Network:
    """Makes and trains a network.

    Args:
        make: gives the network, with fresh weights.
        loss_of: gives the loss of a batch, from the network, the images' indices and the generator of augmentation.
        seed: of weights, order and augmentation.
        progress: called with each epoch's number and loss.
    """
    generator = np.random.default_rng(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = make().to(device, **CHANNELS_LAST)
    optimiser = torch.optim.Adam(network.parameters(), _LEARNING_RATE, fused=True)
    batches = -(-count // _BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _LEARNING_RATE, total_steps=epochs * batches)
    network.train()
    for epoch in range(epochs):
        total = 0.0
        for rows in np.array_split(generator.permutation(count), batches):
            with bfloat16_on_processor():
                loss = loss_of(network, rows, generator)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += float(loss.detach()) * len(rows) / count
        if progress is not None:
            progress(epoch, total)
    network.to(**CHANNELS_FIRST)
    return network.eval()


def most_enhanced(image: NDArray[np.uint8], plain: NDArray[np.uint8]) -> float:
    """How often the noise in the difference of two images goes into `NOISE`, 1 to 4 times.

    It is taken from pixels that became brighter, which no wire does: half of those without a wire.

    Args:
        image, plain: grey, from the same camera, with the wire and without. Shape (height, width).
    """
    brighter = np.minimum(plain.astype(np.float32) - image, 0.0)[plain > _LIT]
    deviation = float(np.sqrt(2 * np.mean(np.square(brighter)))) if brighter.size else NOISE
    return float(np.clip(NOISE / max(deviation, 1e-6), 1.0, _MOST))


def darkening(image: NDArray[np.uint8], plain: NDArray[np.uint8], most: float) -> NDArray[np.float32]:
    """How much darker an image is than another, grey levels, relative to its brightness where that is below `BRIGHT`.

    Args:
        image, plain: grey, of any one shape.
        most: times that a difference is enhanced.
    """
    before = plain.astype(np.float32)
    share = np.clip(BRIGHT / np.maximum(before, 1.0), 1.0, np.float32(most))
    return np.asarray((before - image) * share, np.float32)


class WireSegmenter(nn.Module):
    """Probability of the wire for every pixel; it looks 16 px in every direction.

    Args:
        width: channels of each layer.
    """

    def __init__(self, width: int = 8) -> None:
        super().__init__()
        self.width = width
        layers: list[nn.Module] = [nn.Conv2d(1, width, 5, padding=2), nn.ReLU()]
        for dilation in _DILATIONS:
            layers += [nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation), nn.ReLU()]
        head = nn.Conv2d(width, 1, 1)
        nn.init.constant_(head.bias, _RARE)  # type: ignore[arg-type]  # else it soon learns to say no everywhere
        self.layers = nn.Sequential(*layers, head)

    def forward(self, darker: Tensor) -> Tensor:
        """Logits from grey levels that were lost to the wire. Shape (N, 1, height, width) to the same."""
        return self.layers(darker / DARKENING)

    @torch.inference_mode()
    def mask(self, image: NDArray[np.uint8], plain: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The wire's pixels in an image; gaps of up to four pixels are closed.

        Args:
            image: grey. Shape (height, width).
            plain: without the wire, from the same camera. Shape (height, width).

        Returns:
            255 on the wire, 0 elsewhere. Shape (height, width).

        Raises:
            ValueError: images of different shapes.
        """
        if image.shape != plain.shape:
            raise ValueError(f"expected two images of one shape, got {image.shape} and {plain.shape}")
        self.eval()
        seen = darkening(image, plain, most_enhanced(image, plain))
        darker = torch.as_tensor(seen)[None, None].to(device_of(self))
        wire = torch.sigmoid(self(darker))[0, 0]
        closed = torch.maximum(wire, -_dilated(-_dilated(wire)))
        return (closed > _LEAST).to(torch.uint8).cpu().numpy() * np.uint8(255)


def _dilated(image: Tensor) -> Tensor:
    """The largest value within `_GAP` px along rows and columns, in a twentieth of the time of `max_pool2d`.

    Args:
        image: shape (height, width).
    """
    for axis, beside in enumerate(((0, 0, _GAP, _GAP), (_GAP, _GAP))):
        wide, size = functional.pad(image, beside, value=-torch.inf), image.shape[axis]
        image = functools.reduce(torch.maximum, [wide.narrow(axis, first, size) for first in range(2 * _GAP + 1)])
    return image


def fit_wire_segmenter(
    images: NDArray[np.uint8],
    plains: NDArray[np.uint8],
    masks: NDArray[np.uint8],
    *,
    epochs: int = 6,
    seed: int = 0,
    progress: Callable[[int, float], None] | None = None,
    device: torch.device | str = "cpu",
) -> tuple[WireSegmenter, float]:
    """Trains a segmenter on parts of images, mirrored and turned by right angles at random.

    Args:
        images: grey levels with a wire. Shape (n, size, size).
        plains: the same without it. Shape (n, size, size).
        masks: the wire's pixels, not 0. Shape (n, size, size).
        progress: called with each epoch's number and loss.

    Returns:
        The segmenter, and the Dice score of its masks on the training images.

    Raises:
        ValueError: no images, or of other shapes than the masks.
    """
    shapes = {images.shape, plains.shape, masks.shape}
    if len(shapes) != 1 or images.ndim != 3 or not len(images):
        raise ValueError(f"expected images and masks of one shape (n, size, size), got {sorted(shapes)}")

    most = [most_enhanced(image, plain) for image, plain in zip(images, plains, strict=True)]

    def loss_of(network: WireSegmenter, rows: NDArray[np.intp], generator: np.random.Generator) -> Tensor:
        parts = [_part(images[k], plains[k], masks[k], most[k], generator) for k in rows]
        darker, wire = (torch.as_tensor(np.stack(one))[:, None].to(device) for one in zip(*parts, strict=True))
        return _loss(network(darker).float(), wire)

    network = fitted(WireSegmenter, len(images), loss_of, epochs=epochs, seed=seed, progress=progress, device=device)
    return network, dice(network, images, plains, masks)


def dice(
    network: WireSegmenter, images: NDArray[np.uint8], plains: NDArray[np.uint8], masks: NDArray[np.uint8]
) -> float:
    """Dice score of the segmented wires and the true ones, all images together."""
    both = either = 0
    for image, plain, mask in zip(images, plains, masks, strict=True):
        predicted, true = network.mask(image, plain) > 0, mask > 0
        both += int((predicted & true).sum())
        either += int(predicted.sum() + true.sum())
    return 2 * both / max(either, 1)


def _part(
    image: NDArray[np.uint8],
    plain: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    most: float,
    generator: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What is darker in a square of an image, and the wire there; mirrored and turned at random."""
    size = image.shape[-1]
    side = min(_CROP, size)
    corner = generator.integers(0, size - side + 1, 2)
    seen = np.argwhere(mask)
    if len(seen) and generator.random() < _ON_WIRE:
        middle = seen[generator.integers(len(seen))] - side // 2 + generator.integers(-side // 6, side // 6 + 1, 2)
        corner = np.clip(middle, 0, size - side)
    square = slice(corner[0], corner[0] + side), slice(corner[1], corner[1] + side)
    both = np.stack((darkening(image[square], plain[square], most), (mask[square] > 0).astype(np.float32)))
    both = np.rot90(both, int(generator.integers(4)), (1, 2))
    if generator.random() < 0.5:
        both = both[:, :, ::-1]
    darker, wire = np.ascontiguousarray(both)
    return darker, wire


def _loss(logits: Tensor, wire: Tensor) -> Tensor:
    """Cross-entropy, and one less the Dice score, which does not mind how few pixels show the wire."""
    probability = torch.sigmoid(logits)
    overlap = (2 * (probability * wire).sum() + 1) / (probability.sum() + wire.sum() + 1)
    return functional.binary_cross_entropy_with_logits(logits, wire) + 1 - overlap


def wire_frames(
    environment: gymnasium.Env[Any, Any],
    expert: Policy,
    cases: Sequence[int],
    generator: np.random.Generator,
    tick: Callable[[int], None] = lambda done: None,
    names: Sequence[str] = ("image", "plain", "mask"),
) -> tuple[NDArray[np.uint8], ...]:
    """Images of episodes that an expert steers, each with a share of noise in its actions, from none to all.

    So the segmenter also sees tips that fold at walls and lie in wrong branches.

    Args:
        environment: with the expert's observations, those of `names`, and the option `case` of a reset; of every
            `BETWEEN`-th step the latter are enough.
        tick: called with the number of finished episodes.
        names: of the observations that are kept, each of one camera or of several.

    Returns:
        Of each name the images. Shapes (n, size, size).
    """
    frames: list[list[NDArray[np.uint8]]] = [[] for _ in names]
    for number, case in enumerate(cases):
        tick(number)
        observation, _ = environment.reset(seed=int(generator.integers(2**31)), options={"case": case})
        steer = PerturbedController(expert, generator)
        over, step = False, 0
        while not over:
            if step % BETWEEN == 0:
                for images, name in zip(frames, names, strict=True):
                    images.extend(observation[name])
            observation, _, terminated, truncated, _ = environment.step(steer(observation))
            over, step = terminated or truncated, step + 1
    return tuple(np.stack(images) for images in frames)
