"""Binary messages to the page over the websocket: pictures and surfaces.

A picture is `FRME`, the length of a JSON header (uint32), the header padded with spaces to a multiple of 4, the wire's
points (float32, n x 3, m), those of the catheter where there is one, and the JPEGs of the views, one behind the other;
the header counts the points and the bytes of each JPEG. A
surface is `MESH`, the numbers of vertices and faces (uint32), vertices and normals (float32, m), faces (uint32).
Numbers are little-endian.
"""

from __future__ import annotations

import json
import struct
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cathsim.anatomy import Phantom
from cathsim.anatomy.surface import lumen_surface

_STRIDE = 2  # grid nodes a node of the 3-D view's surface
FRAME_MAGIC, SURFACE_MAGIC = b"FRME", b"MESH"


Work = Callable[[], None]


def frame_message(
    header: Mapping[str, Any], points: np.ndarray, *jpegs: bytes, catheter: np.ndarray | None = None
) -> bytes:
    """Packs a picture.

    Args:
        points: of the wire, from its tip on, m, world frame. Shape (n, 3).
        jpegs: the fluoroscopic images, a view each.
        catheter: points of the catheter, as the wire's. Shape (k, 3); None: there is none.
    """
    counts: dict[str, Any] = {"points": len(points), "jpeg_bytes": [len(jpeg) for jpeg in jpegs]}
    counts |= {} if catheter is None else {"catheter_points": len(catheter)}
    text = json.dumps({**header, **counts}).encode()
    text += b" " * (-len(text) % 4)
    devices = [points.astype("<f4").tobytes(), b"" if catheter is None else catheter.astype("<f4").tobytes()]
    return b"".join((FRAME_MAGIC, struct.pack("<I", len(text)), text, *devices, *jpegs))


def surface_message(vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> bytes:
    """Packs a surface: vertices (v, 3) m in the world frame, normals (v, 3) out of the lumen, faces (f, 3)."""
    head = SURFACE_MAGIC + struct.pack("<II", len(vertices), len(faces))
    return b"".join(
        (head, vertices.astype("<f4").tobytes(), normals.astype("<f4").tobytes(), faces.astype("<u4").tobytes())
    )


def surface_of(phantom: Phantom) -> bytes:
    """The lumen's surface for the 3-D view, as a message."""
    mesh = lumen_surface(phantom.grid.coarser(_STRIDE))
    return surface_message(np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals), np.asarray(mesh.faces))


class Inbox:
    """Hands work to the loop's thread.

    What is asked for twice before the loop comes to it is done once, as it was asked for last: a page that sends a
    thousand wishes to restart gets one. The controls do not come this way: see `ControlPanel`.
    """

    def __init__(self) -> None:
        self._filled = threading.Condition()
        self._waiting: OrderedDict[str, Work | None] = OrderedDict()

    def put(self, kind: str, work: Work | None = None) -> None:
        """Asks the loop for work (None only wakes it up); a newer one replaces an older one of the same kind."""
        with self._filled:
            self._waiting.pop(kind, None)
            self._waiting[kind] = work
            self._filled.notify()

    def get(self, timeout_s: float) -> tuple[str, Work | None] | None:
        """The kind and the work that waits for longest, after at most `timeout_s`; None when there was nothing."""
        with self._filled:
            if not self._waiting:
                self._filled.wait(max(timeout_s, 0.0))
            return self._waiting.popitem(last=False) if self._waiting else None

    def __len__(self) -> int:
        """How many wait: never more than there are kinds."""
        with self._filled:
            return len(self._waiting)
