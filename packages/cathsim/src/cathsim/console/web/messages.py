"""What page and console say to each other over the websocket: binary pictures and surfaces, checked JSON requests.

A picture is `FRME`, the length of a JSON header (uint32), the header padded with spaces to a multiple of 4, the wire's
points (float32, n x 3, m), those of the catheter where there is one, and the JPEGs of the views, one behind the other;
the header counts the points and the bytes of each JPEG. A
surface is `MESH`, the numbers of vertices and faces (uint32), vertices and normals (float32, m), faces (uint32).
Numbers are little-endian.
"""

from __future__ import annotations

import ipaddress
import json
import secrets
import struct
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from cathsim.anatomy import Phantom
from cathsim.anatomy.surface import lumen_surface

_STRIDE = 2  # grid nodes a node of the 3-D view's surface
FRAME_MAGIC, SURFACE_MAGIC = b"FRME", b"MESH"
LONGEST_REQUEST = 16_384  # characters
_LONGEST_VALUE = 60  # characters of a wrong value that are shown
_LARGEST_SEQUENCE = 2**53  # the whole numbers that JavaScript counts exactly
_Name = Annotated[str, Field(min_length=1, max_length=100)]
_Axis = Annotated[float, Field(ge=-1e6, le=1e6)]  # beyond -1 to 1 it counts as full speed
_Move = Annotated[list[_Axis], Field(min_length=2, max_length=2)]  # translation and rotation
KINDS = ("controls", "release", "choose", "restart", "replay", "answers", "view", "pedal", "roadmap", "inject")

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


def is_loopback(host: str) -> bool:
    """Whether a host name or an address means this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Access:
    """Decides on requests."""

    token: str | None = None  # what the address must carry; None lets in pages of this machine only

    def refusal(self, headers: Mapping[str, str], token: str) -> str:
        """One sentence that says why a request is refused; "" lets it in.

        Args:
            headers: of the request, names in lower case.
        """
        host = headers.get("host", "")
        # without this check any web page that the operator has open could steer the wire through a websocket
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return "pages of other sites may not use the console"
        if self.token is not None:
            if not secrets.compare_digest(token.encode(), self.token.encode()):
                return "this console needs its token: open the address that it printed when it started"
        elif not is_loopback(_name(host)):
            # a foreign name that leads to this machine would make a foreign page one of its own
            return "this console answers to localhost and 127.0.0.1 only"
        return ""


def _name(host: str) -> str:
    """The host name in a Host header, without port and brackets; "" when it is malformed."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Controls(_Request):
    type: Literal["controls"]
    advance: _Axis
    rotate: _Axis
    sequence: Annotated[int, Field(ge=0, le=_LARGEST_SEQUENCE)]
    catheter: _Move = [0.0, 0.0]  # left out: the catheter stands still


class _Choose(_Request):
    type: Literal["choose"]
    phantom: _Name
    target: _Name
    catheter: _Name | None = None  # a catheter of the shelf; None: no catheter; left out: that of before
    wire: _Name = ""  # left out: that of before
    max_steps: Annotated[int, Field(ge=1, le=10_000)] = 300  # left out: that of before, as those that follow
    success_radius_mm: Annotated[float, Field(ge=1, le=50)] = 8.0
    force_limit_n: Annotated[float, Field(gt=0, le=100)] = 2.0
    ends_at_force_limit: bool = False


class _View(_Request):
    type: Literal["view"]
    camera: Literal["a", "b"]
    primary_deg: Annotated[float, Field(ge=-120, le=120)]
    secondary_deg: Annotated[float, Field(ge=-50, le=50)]
    zoom: Annotated[float, Field(ge=1, le=4)]


class _Switch(_Request):
    type: Literal["pedal", "roadmap"]
    on: bool


class _Answers(_Request):
    type: Literal["answers"]
    answers: Annotated[dict[_Name, int | str], Field(max_length=50)]


class _Plain(_Request):
    type: Literal["release", "restart", "replay", "inject"]


_REQUESTS: TypeAdapter[Any] = TypeAdapter(
    Annotated[_Controls | _Choose | _View | _Switch | _Answers | _Plain, Field(discriminator="type")]
)


def read_request(request: str | Mapping[str, Any]) -> dict[str, Any]:
    """Reads what the page asks for, in JSON or as its content; a request has the fields that its type has, no other.

    A field that may be left out (a catheter, wire or limit) is then not in the result.

    Raises:
        ValueError: it is no request; one sentence says why.
    """
    if isinstance(request, str) and len(request) > LONGEST_REQUEST:
        raise ValueError(f"a request may have {LONGEST_REQUEST} characters, got {len(request)}")
    try:
        if isinstance(request, str):
            read = _REQUESTS.validate_json(request)
        else:
            read = _REQUESTS.validate_python(dict(request))
    except ValidationError as error:
        raise ValueError(_sentence(error)) from error
    content: dict[str, Any] = read.model_dump(exclude_unset=True)
    return content


def _sentence(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    if first["type"] == "json_invalid":
        return "a request must be JSON"
    kind = first["loc"][0] if first["loc"] else ""
    if not kind:
        request_type = first["input"].get("type") if isinstance(first["input"], dict) else None
        return f"a request needs a type, one of {', '.join(KINDS)}, got {_shown(request_type)}"
    field = ".".join(str(part) for part in first["loc"][1:])[:_LONGEST_VALUE]
    if first["type"] == "missing":
        return f"request '{kind}' needs the field {field}"
    if first["type"] == "extra_forbidden":
        return f"request '{kind}' has no field {field}"
    if first["type"] in ("too_short", "too_long") and isinstance(first["input"], list):
        count = first["ctx"].get("min_length", first["ctx"].get("max_length"))
        return f"request '{kind}' is refused: {field} should have {count} numbers, got {len(first['input'])}"
    must = first["msg"].split(" should ", 1)[-1]
    return f"request '{kind}' is refused: {field} should {must}, got {_shown(first['input'])}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}…"
