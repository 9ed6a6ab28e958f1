"""Reader: from an X-ray image of any size to maps of wire, catheter and tip, by the shipped network or another."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

try:
    import torch
except ModuleNotFoundError:
    from guide3d.commands import require

    require("torch", "learning")  # says what to install
    raise

from guide3d.learning.bounded_content import built_from
from guide3d.learning.model_file import UNFIT, another_architecture, read_model, write_model
from guide3d.learning.precision import has_bfloat16
from guide3d.modeling.reader_network import ReaderNetwork, reader_input, without_normalisation

KIND = "reader"
VERSION = 1  # of input, targets and architecture: a file of another one is refused
SHIPPED = "reader.pt"
_LARGEST_PX = 8192


@dataclass(frozen=True, eq=False)
class ReaderMaps:
    """What the network sees in an image: (h, w) float32 each, 0 to 1.

    Attributes:
        wire: along wires, in a strip of about 6 px around their centre line.
        catheter: on catheters, over their whole width.
        tip: a blob of a standard deviation of about 3 px at each wire's tip.
    """

    wire: NDArray[np.float32]
    catheter: NDArray[np.float32]
    tip: NDArray[np.float32]


class Reader:
    """Network and precision with which images are read."""

    def __init__(self, network: ReaderNetwork, metadata: dict[str, Any] | None = None, fast: bool = True) -> None:
        """Args:
        metadata: of the network's training.
        fast: use bfloat16 where the processor has it: half the time, maps that differ by about 0.01.
        """
        self.metadata = metadata or {}
        self.network = network.eval()
        self._type = torch.bfloat16 if fast and has_bfloat16() else torch.float32
        fused: Any = without_normalisation(network)
        self._network = fused.to(dtype=self._type, memory_format=torch.channels_last)

    @classmethod
    def pretrained(cls) -> Reader:
        """The reader that is shipped with the package.

        Raises:
            ValueError: its file is damaged or of another version.
        """
        with as_file(files("guide3d.weights") / SHIPPED) as path:
            return cls.load(path)

    @classmethod
    def load(cls, path: Path | str, fast: bool = True) -> Reader:
        """Reads what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, no reader, or of another version.
        """
        content = read_model(path, KIND)
        version = content["network"].get("version")
        if version != VERSION:
            raise ValueError(f"{path} is a reader of version {version!a:.80}, expected {VERSION}: train it again")
        try:
            size = content["network"]
            with built_from(content):
                network = ReaderNetwork(block_px=size["block_px"], widths=tuple(size["widths"]))
            network.load_state_dict({name: value.float() for name, value in content["weights"].items()})
        except UNFIT as error:
            raise another_architecture(path, error) from error
        return cls(network, content["metadata"], fast)

    def save(self, path: Path | str) -> None:
        """Writes the network, in half precision; a reader sees the former file or this one."""
        write_model(
            path,
            kind=KIND,
            network={"version": VERSION, "block_px": self.network.block_px, "widths": list(self.network.widths)},
            preprocessing={"input": "log and local log"},
            module=copy.deepcopy(self.network).half(),
            metadata=self.metadata,
        )

    def maps(self, image: NDArray[np.uint8]) -> ReaderMaps:
        """Reads an image (h, w) uint8 of at most 8192 px a side.

        Raises:
            ValueError: another shape or type.
        """
        if image.ndim != 2 or image.dtype != np.uint8 or not image.size or max(image.shape) > _LARGEST_PX:
            raise ValueError(
                f"expected a grey image (h, w) uint8 of at most {_LARGEST_PX} px a side, "
                f"got {image.shape}, {image.dtype}"
            )
        height, width = image.shape
        multiple = self.network.multiple_px
        padded = np.pad(image, ((0, -height % multiple), (0, -width % multiple)), mode="edge")
        seen = torch.from_numpy(reader_input(padded))[None].to(self._type)
        with torch.inference_mode():
            logits = self._network(seen.contiguous(memory_format=torch.channels_last))
            chance = logits.float().sigmoid()[0, :, :height, :width].contiguous().numpy()
        return ReaderMaps(chance[0], chance[1], chance[2])
