"""Who may use the console: pages of this machine, or whoever knows the token; never a page of another site."""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit


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
