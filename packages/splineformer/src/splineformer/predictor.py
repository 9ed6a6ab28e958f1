"""Predictor: an image in, the wire as a B-spline out. The only border between numpy and torch."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from guide3d.geometry.bspline import BSplineCurve
from guide3d.geometry.polyline import Array, arc_length
from guide3d.learning.model_file import UNFIT, read_model, write_model
from splineformer.build import Network, described, rebuilt
from splineformer.image_input import Picture, picture_of
from splineformer.learning.samples import pixels_of_shares
from splineformer.modeling.image_head import WIRES
from splineformer.modeling.splineformer import SplineFormer
from splineformer.tokens import FEWEST_TOKENS, curve_of_tokens, sampled

KIND = "splineformer"
SOURCE_PX = 1024
_BATCH = 8
_LENGTH_SAMPLES = 400


@dataclass(frozen=True, eq=False)
class Prediction:
    """A wire that was read off an image.

    Attributes:
        wires: "none", "one" or "several": what the image seems to show.
        tokens: (n, 3) knot (px along the wire from the tip), x, y (px); None where there seems to be no wire.
        confidence: 0 to 1.
        error_px: expected mean distance of the curve from the wire, of the ordered variant; else None.
        inverted: the wire is brighter than its surroundings; the image was read with its grey levels turned over.
        remarks: sentences about what is odd.
    """

    wires: str
    tokens: Array | None
    confidence: float
    error_px: float | None
    inverted: bool
    remarks: tuple[str, ...]

    def _there(self) -> Array:
        if self.tokens is None:
            raise ValueError("the image shows no wire: look at `wires` before asking for its curve")
        return self.tokens

    @property
    def curve(self) -> BSplineCurve:
        """The wire, tip first, px; its parameter is the way along it."""
        return curve_of_tokens(self._there())

    @property
    def control_points_px(self) -> Array:
        """(n, 2) of the curve."""
        return self.curve.coefficients

    @property
    def knots_px(self) -> Array:
        """(n + 4,) of the curve."""
        return self.curve.knots

    @property
    def tip_px(self) -> Array:
        """(2,) the wire's tip."""
        return self._there()[0, 1:]

    def points(self, count: int = 200) -> Array:
        """(count, 2) points of the wire at equal arc length, px."""
        return sampled(self._there(), count)


class Predictor:
    """Reads wires off images.

    Args:
        network: either variant.
        source_px: side of the images that it was trained on, before they were made small.
        device: where it computes.
        compiled: let torch compile the network; worth it for many images of one batch size.
        backend: of the compiler.
    """

    def __init__(
        self,
        network: Network,
        *,
        source_px: int = SOURCE_PX,
        device: str = "cpu",
        compiled: bool = False,
        backend: str | Callable[..., Any] = "inductor",
    ) -> None:
        # compiling changes a network in place: the caller's stays as it is
        self.network = (copy.deepcopy(network) if compiled else network).to(device).eval()
        network = self.network
        self.source_px = source_px
        self.device = torch.device(device)
        self._forward: Any = network.decode if isinstance(network, SplineFormer) else network.read
        if compiled:
            # part by part: the sequences that the published variant unrolls end where the image says
            for part in network.children():
                part.compile(backend=backend)

    @classmethod
    def load(cls, path: Path | str, **options: Any) -> Predictor:
        """Reads a model file.

        Args:
            path: that `save` wrote.
            options: of the predictor.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, of another kind, or of another version.
        """
        told = read_model(path, KIND)
        try:
            network = rebuilt(told["network"])
            network.load_state_dict(told["weights"])
            source_px = int(told["preprocessing"]["source_px"])
        except UNFIT as error:
            reason = " ".join(str(error).split())[:200]
            raise ValueError(f"{path} cannot be used: {reason}") from error
        return cls(network, source_px=source_px, **options)

    def save(self, path: Path | str, **metadata: Any) -> None:
        """Writes the network with its settings, whole or not at all.

        Args:
            path: of the file.
            metadata: what else is known: numbers and strings.
        """
        size = self.network.settings.image_px
        write_model(
            path,
            kind=KIND,
            network=described(self.network),
            preprocessing={"size_px": size, "source_px": self.source_px},
            module=self.network,
            metadata=metadata,
        )

    def __call__(self, image: ArrayLike) -> Prediction:
        """Reads one image: (h, w) grey levels of any depth.

        Raises:
            ValueError: no image, or too small a one.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[ArrayLike] | NDArray[Any]) -> list[Prediction]:
        """Reads images, several at once.

        Args:
            images: (h, w) each; they may differ in size.

        Returns:
            A prediction each.

        Raises:
            ValueError: which image is none, and why.
        """
        pictures = []
        for number, image in enumerate(images):
            try:
                pictures.append(picture_of(image, self.network.settings.image_px, self.source_px))
            except ValueError as error:
                raise ValueError(f"image {number}: {error}" if len(images) > 1 else str(error)) from None
        told: list[Prediction] = []
        for start in range(0, len(pictures), _BATCH):
            told += self._read(pictures[start : start + _BATCH])
        return told

    @torch.inference_mode()
    def _read(self, pictures: list[Picture]) -> list[Prediction]:
        levels = torch.from_numpy(np.stack([picture.pixels for picture in pictures]))[:, None].float().to(self.device)
        tokens, kinds, inverted, quality, errors = self._outputs(levels)
        turned = torch.sigmoid(inverted) > 0.5
        if bool(turned.any()):
            again = self._outputs(255.0 - levels[turned])
            for place, row in enumerate(torch.nonzero(turned)[:, 0].tolist()):
                tokens[row], quality[row], errors[row] = again[0][place], again[3][place], again[4][place]
                kinds[row] = again[1][place]
        return [
            _prediction(
                picture, tokens[row], torch.softmax(kinds[row], -1), bool(turned[row]), quality[row], errors[row]
            )
            for row, picture in enumerate(pictures)
        ]

    def _outputs(self, levels: Tensor) -> tuple[list[Array], Tensor, Tensor, list[float], list[float | None]]:
        """Tokens as shares of the side, logits about the image, and how good the curves are."""
        network = self.network
        if isinstance(network, SplineFormer):
            decoded = self._forward(levels)
            rows = decoded.tokens.double().cpu().numpy()
            tokens = [row[: max(int(n), FEWEST_TOKENS)] for row, n in zip(rows, decoded.lengths, strict=True)]
            ends = [float(end[int(n) - 1]) for end, n in zip(decoded.end, decoded.lengths, strict=True)]
            return tokens, decoded.kind.wires, decoded.kind.inverted, ends, [None] * len(tokens)
        reading = self._forward(levels)
        said = reading.said
        knots = network.knots.double().cpu().numpy()[FEWEST_TOKENS:]
        control = reading.control.double().cpu().numpy()
        return (
            [np.column_stack([knots, points]) for points in control],
            said.kind.wires,
            said.kind.inverted,
            reading.support.tolist(),
            reading.error.tolist(),
        )


def _prediction(
    picture: Picture, tokens: Array, kinds: Tensor, inverted: bool, quality: float, error: float | None
) -> Prediction:
    likely = WIRES[int(kinds.argmax())]
    remarks = list(picture.remarks)
    if inverted:
        remarks.append("grey levels are inverted: the image was turned over before reading")
    error_px = None if error is None else error * picture.side_px
    if likely == "none":
        remarks.append("the image seems to show no wire")
        return Prediction(likely, None, float(kinds[0]), None, inverted, tuple(remarks))
    if likely == "several":
        remarks.append("the image seems to show more than one wire: the curve is one of them, or a mixture")
    return Prediction(
        likely, tokens_px(tokens, picture.side_px), float(kinds[1]) * quality, error_px, inverted, tuple(remarks)
    )


def tokens_px(tokens: Array, side_px: float) -> Array:
    """Tokens in shares of the side, knots of any scale, to tokens in pixels with knots along the curve."""
    knots = np.maximum.accumulate(np.maximum(tokens[:, 0], 0.0))
    points = pixels_of_shares(tokens[:, 1:], (side_px, side_px))
    if knots[-1] <= 0:
        knots = np.concatenate([np.linspace(0, 1, len(knots) - FEWEST_TOKENS + 1)[1:], np.ones(FEWEST_TOKENS - 1)])
    curve = curve_of_tokens(np.column_stack([knots, points]))
    length = max(float(arc_length(curve.sample(_LENGTH_SAMPLES))[-1]), 1e-6)
    return np.column_stack([curve.knots[FEWEST_TOKENS:] * (length / curve.knots[-1]), points])
