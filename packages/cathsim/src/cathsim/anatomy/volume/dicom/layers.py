"""Segments that may overlap as few volumes of labels: a segment goes to the first in which nothing is in its way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.source import Slab

_MOST_BYTES = 3_000_000_000  # of all layers


class Layers:
    """Volumes of labels, filled segment by segment.

    Args:
        shape: voxels along the axes.
        file: for messages.
    """

    def __init__(self, shape: tuple[int, int, int], file: str) -> None:
        self.shape, self.file = shape, file
        self.volumes: list[NDArray[np.uint16]] = []

    def add(self, number: int, slices: dict[int, NDArray[np.bool_]]) -> int:
        """Puts a segment of masks (nx, ny) by slice where it overlaps no other; returns its layer."""
        free = [
            layer
            for layer, volume in enumerate(self.volumes)
            if not any((volume[:, :, at] != 0)[mask].any() for at, mask in slices.items())
        ]
        layer = free[0] if free else len(self.volumes)
        if not free:
            if (layer + 1) * 2 * float(np.prod(self.shape)) > _MOST_BYTES:
                raise MeshRefusedError(
                    f"{self.file} has segments that overlap over too many voxels; export the vessels alone."
                )
            self.volumes.append(np.zeros(self.shape, dtype=np.uint16, order="F"))
        for at, mask in slices.items():
            self.volumes[layer][:, :, at][mask] = number
        return layer

    def slabs(self) -> Iterator[Slab]:
        """Slice by slice, (layers, nx, ny, 1)."""
        for at in range(self.shape[2]):
            yield at, np.stack([volume[:, :, at : at + 1] for volume in self.volumes])
