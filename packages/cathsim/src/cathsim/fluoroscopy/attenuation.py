"""The background of a fluoroscopic image: attenuation integrated once along every ray through lumen and body."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cathsim.fluoroscopy.projector import Projector
from cathsim.fluoroscopy.scene import THORAX, Solid, body_depth
from cathsim.lattice.node_blocks import LatticeStruct, NodeBlocks

CONTRAST = 28.0  # 1/m, diluted iodine over blood
GAMMA = 0.5  # of the display: wide enough a range for lungs, spine and wire in one image
MIDDLE = 120.0  # grey level of the median depth in the middle of the background, where the exposure is measured
_BORDER = 0.2  # of the image on each side, left out where the exposure is measured
_RAYS = 256  # rays along the shorter side at least, so that small images have smooth edges


class DistanceGrid(Protocol):
    """Signed distance to the vessel's wall on a lattice, positive inside."""

    @property
    def blocks(self) -> NodeBlocks:
        """Distances, m."""

    @property
    def origin(self) -> NDArray[np.float64]:
        """(3,) m, world position of node (0, 0, 0)."""

    @property
    def spacing(self) -> float:
        """m."""


class _GridStruct(ctypes.Structure):
    """struct DistanceGrid of fluoroscopy.c."""

    _fields_ = (
        ("origin", ctypes.c_double * 3),
        ("spacing", ctypes.c_double),
        ("distance", LatticeStruct),
    )


def lumen_path_length(
    grid: DistanceGrid, projector: Projector, *, level: float = 0.0, samples: int | None = None
) -> NDArray[np.float32]:
    """Length (height, width) m of every pixel's ray inside the lumen.

    Args:
        level: m; where the distance exceeds it counts as inside, so a negative one adds a wall of that thickness.
        samples: rays along each side of a pixel, averaged; by default enough for smooth edges.

    Raises:
        ValueError: a distance is not finite.
    """
    from cathsim.contact.native import library

    if not np.isfinite(grid.blocks.nodes).all():
        raise ValueError("a distance grid must be finite: it holds NaN or infinite distances.")
    if samples is None:
        samples = max(1, -(-_RAYS // min(projector.width, projector.height)))
    struct = _GridStruct(
        (ctypes.c_double * 3)(*np.asarray(grid.origin, dtype=np.float64)),
        float(grid.spacing),
        LatticeStruct.of(grid.blocks),
    )
    lengths = np.empty((projector.height, projector.width), dtype=np.float32)
    source, rays = np.ascontiguousarray(projector.source), np.ascontiguousarray(projector.rays)
    integrate = library().cathsim_fluoroscopy_integrate
    integrate.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_double] + [ctypes.c_int] * 3 + [ctypes.c_void_p]
    integrate.restype = None
    integrate(
        ctypes.addressof(struct),
        source.ctypes.data,
        rays.ctypes.data,
        level,
        projector.width,
        projector.height,
        samples,
        lengths.ctypes.data,
    )
    return lengths


def expose(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Grey levels of optical depths by Beer and Lambert's law, under automatic brightness and a display's gamma.

    Args:
        depth: (height, width) optical depth, dimensionless.

    Returns:
        (height, width), 0 to 255, not rounded. An object of depth d put in front multiplies a level by exp(-`GAMMA` d).
    """
    rows, columns = (slice(int(_BORDER * n), n - int(_BORDER * n)) for n in depth.shape)
    reference = np.float32(np.median(depth[rows, columns]))
    return np.minimum(MIDDLE * np.exp(-GAMMA * (depth - reference)), 255.0).astype(np.float32)


def background_image(
    grid: DistanceGrid,
    projector: Projector,
    *,
    contrast: float = CONTRAST,
    body: tuple[Solid, ...] = THORAX,
    key: str | None = None,
) -> NDArray[np.float32]:
    """Fluoroscopic image of the anatomy without a wire: (height, width) grey levels 0 to 255, float32, read-only.

    Args:
        contrast: 1/m, what the contrast agent adds to the lumen's attenuation.
        body: solids around the vessels, placed about the grid's centre.
        key: content hash of the phantom; images of the same key, camera and settings are computed once a process.
    """
    if key is None:
        return _background(grid, projector, contrast, body)
    return _cached_background(Keyed((key, projector.key, contrast, body), grid, projector, contrast, body))


class Keyed:
    """Arguments of a cached function of which the key alone is compared."""

    def __init__(self, key: tuple[Any, ...], *arguments: Any) -> None:
        self.key, self.arguments = key, arguments

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Keyed) and self.key == other.key


@lru_cache(maxsize=64)
def _cached_background(request: Keyed) -> NDArray[np.float32]:
    return _background(*request.arguments)


def _background(
    grid: DistanceGrid, projector: Projector, contrast: float, body: tuple[Solid, ...]
) -> NDArray[np.float32]:
    centre = np.asarray(grid.origin) + (np.array(grid.blocks.shape) - 1) * grid.spacing / 2
    depth = contrast * lumen_path_length(grid, projector) + body_depth(projector, body, centre)
    image = expose(depth)
    image.flags.writeable = False
    return image
