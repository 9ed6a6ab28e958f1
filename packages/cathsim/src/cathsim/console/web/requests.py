"""Requests of the page over the websocket: JSON of a few kinds, checked before use."""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

LONGEST_REQUEST = 16_384  # characters
_LONGEST_VALUE = 60  # characters of a wrong value that are shown
_LARGEST_SEQUENCE = 2**53  # the whole numbers that JavaScript counts exactly
_Name = Annotated[str, Field(min_length=1, max_length=100)]
_Axis = Annotated[float, Field(ge=-1e6, le=1e6)]  # beyond -1 to 1 it counts as full speed
_Move = Annotated[list[_Axis], Field(min_length=2, max_length=2)]  # translation and rotation
KINDS = ("controls", "release", "choose", "restart", "replay", "answers", "view", "pedal", "roadmap", "inject")


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
