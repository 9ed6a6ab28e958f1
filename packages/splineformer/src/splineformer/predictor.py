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

from guide3d.geometry.bspline import BSplineCurve
from guide3d.geometry.polyline import Array
from guide3d.learning.bounded_content import built_from
from guide3d.learning.model_file import UNFIT, read_model, write_model
from guide3d.reading.image_reading import MapReader, shipped_reader
from guide3d.shipped import shipped_file
from splineformer.build import from_spec, to_spec
from splineformer.image_input import Picture, picture_of
from splineformer.map_picture import picture_by_reader
from splineformer.modeling.curve_network import WIRES, CurveBatch, CurveNetwork
from splineformer.tokens import curve_of_tokens, sampled, tokens_px
from splineformer.views import best_of_views

KIND = "splineformer"
INPUTS = ("levels", "maps")
PRETRAINED = "ordered"
SOURCE_PX = 1024
_BATCH = 8


@dataclass(frozen=True, eq=False)
class Prediction:
    """A wire that was read off an image.

    Attributes:
        wires: "none", "one" or "several": what the image seems to show.
        tokens: (n, 3) knot (px along the wire from the tip), x, y (px); None where there seems to be no wire.
        confidence: 0 to 1.
        error_px: expected mean distance of the curve from the wire, of the ordered variant; else None.
        inverted: the wire is brighter than its surroundings; the image was read with its grey levels turned over.
        warnings: sentences about what may make the prediction wrong.
    """

    wires: str
    tokens: Array | None
    confidence: float
    error_px: float | None
    inverted: bool
    warnings: tuple[str, ...]

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
    def tip_px(self) -> Array:
        """(2,) the wire's tip."""
        return self._there()[0, 1:]

    def points(self, count: int = 200) -> Array:
        """(count, 2) points of the wire at equal arc length, px."""
        return sampled(self._there(), count)


class Predictor:
    """Reads wires off images.

    Args:
        source_px: side of the images that it was trained on, before they were made small.
        input: what its pictures are made of: "levels", the grey levels of the image, or "maps", what guide3d's reader
            makes of it; these are read in eight views, and the curve is kept that agrees best with the maps.
        reader: that makes the maps; None: the one that is shipped with guide3d.
        compiled: let torch compile the network; worth it for many images of one batch size.
    """

    def __init__(
        self,
        network: CurveNetwork,
        *,
        source_px: int = SOURCE_PX,
        input: str = "levels",
        reader: MapReader | None = None,
        device: str = "cpu",
        compiled: bool = False,
        backend: str | Callable[..., Any] = "inductor",
    ) -> None:
        if input not in INPUTS:
            raise ValueError(f"unknown input '{input}'; there are {', '.join(INPUTS)}")
        self.input = input
        self._reader = reader
        # compiling changes a network in place: the caller's stays as it is
        self.network = (copy.deepcopy(network) if compiled else network).to(device).eval()
        self.source_px = source_px
        self.device = torch.device(device)
        if compiled:
            # part by part: the sequences that the published variant unrolls end where the image says
            for part in self.network.children():
                part.compile(backend=backend)

    @classmethod
    def load(cls, path: Path | str, **options: Any) -> Predictor:
        """Reads a model file that `save` wrote; the options are those of a new predictor.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, of another kind, or of another version.
        """
        content = read_model(path, KIND)
        try:
            with built_from(content):
                network = from_spec(content["network"])
            network.load_state_dict(content["weights"])
            source_px = int(content["preprocessing"]["source_px"])
            input = str(content["preprocessing"]["input"])
            if input not in INPUTS:
                raise ValueError(f"unknown input '{input}'")
        except UNFIT as error:
            reason = " ".join(str(error).split())[:200].encode("ascii", "backslashreplace").decode()
            raise ValueError(f"{path} cannot be used: {reason}") from error
        return cls(network, source_px=source_px, input=input, **options)

    @classmethod
    def pretrained(cls, name: str = PRETRAINED, **options: Any) -> Predictor:
        """Loads a network that is shipped with the package; the options are those of a new predictor.

        Args:
            name: one of `splineformer.models()`.

        Raises:
            ValueError: there is none of this name, or its file is damaged or of a format that this version does not
                read.
        """
        with shipped_file(name, "splineformer") as path:
            return cls.load(path, **options)

    def save(self, path: Path | str, *, half: bool = False, **metadata: Any) -> None:
        """Writes the network with its settings and metadata (numbers and strings), whole or not at all.

        Args:
            half: weights of 16 bits: half the size, curves that differ by a pixel or so.
        """
        size = self.network.settings.image_px
        write_model(
            path,
            kind=KIND,
            network=to_spec(self.network),
            preprocessing={"size_px": size, "source_px": self.source_px, "input": self.input},
            module=copy.deepcopy(self.network).half() if half else self.network,
            metadata=metadata,
        )

    def __call__(self, image: ArrayLike) -> Prediction:
        """Reads one image: (h, w) grey levels of any depth.

        Raises:
            ValueError: no image, or too small a one.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[ArrayLike] | NDArray[Any]) -> list[Prediction]:
        """Reads several (h, w) images, which may differ in size.

        Raises:
            ValueError: which image is none, and why.
        """
        pictures = []
        for number, image in enumerate(images):
            try:
                pictures.append(self.picture(image))
            except ValueError as error:
                raise ValueError(f"image {number}: {error}" if len(images) > 1 else str(error)) from None
        predictions: list[Prediction] = []
        for start in range(0, len(pictures), _BATCH):
            predictions += self._read(pictures[start : start + _BATCH])
        return predictions

    def picture(self, image: ArrayLike) -> Picture:
        """The small picture that the network sees of an image (h, w).

        Raises:
            ValueError: no image, or too small a one.
        """
        size = self.network.settings.image_px
        if self.input == "levels":
            return picture_of(image, size, self.source_px)
        return picture_by_reader(image, size, self._reader or shipped_reader())

    @torch.inference_mode()
    def _read(self, pictures: list[Picture]) -> list[Prediction]:
        levels = torch.from_numpy(np.stack([picture.pixels for picture in pictures]))[:, None].float().to(self.device)
        if self.input == "maps":
            curves = best_of_views(self.network, levels)
            return [_prediction(picture, curves, row, picture.inverted) for row, picture in enumerate(pictures)]
        curves = self.network.read(levels)
        inverted = torch.sigmoid(curves.kind.inverted) > 0.5
        source = [(curves, row) for row in range(len(pictures))]
        if bool(inverted.any()):
            again = self.network.read(255.0 - levels[inverted])
            for place, row in enumerate(torch.nonzero(inverted)[:, 0].tolist()):
                source[row] = (again, place)
        return [_prediction(picture, *source[row], bool(inverted[row])) for row, picture in enumerate(pictures)]


def _prediction(picture: Picture, curves: CurveBatch, row: int, inverted: bool) -> Prediction:
    kinds = torch.softmax(curves.kind.wires[row], -1)
    wires = WIRES[int(kinds.argmax())]
    warnings = list(picture.warnings)
    if inverted:
        warnings.append("grey levels are inverted: the image was turned over before reading")
    if wires == "none":
        warnings.append("the image seems to show no wire")
        return Prediction(wires, None, float(kinds[0]), None, inverted, tuple(warnings))
    if wires == "several":
        warnings.append("the image seems to show more than one wire: the curve is one of them, or a mixture")
    tokens = curves.tokens[row, : int(curves.lengths[row])].double().cpu().numpy()
    confidence = float(kinds[1]) * float(curves.quality[row])
    error_px = None if curves.error is None else float(curves.error[row]) * picture.side_px
    return Prediction(wires, tokens_px(tokens, picture.side_px), confidence, error_px, inverted, tuple(warnings))
