"""Download of a file by HTTPS: resumed where it was cut off, verified by its SHA-256, and moved to its place whole."""

from __future__ import annotations

import http.client
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

from pipeline.store.provenance import hash_file

_BLOCK = 1 << 16
_TIMEOUT_S = 30
_PARTIAL, _NOTHING_LEFT = 206, 416
_LOOPBACK = ("127.0.0.1", "localhost")


class DownloadError(Exception):
    """Why a file did not arrive; what arrived of it is kept."""


def download(url: str, place: Path, size: int, sha256: str, tell: Callable[[int], None] = lambda _: None) -> None:
    """Downloads a file, from where an earlier try was cut off.

    Args:
        url: of HTTPS, or of this machine.
        place: of the file; until it is whole and verified its content is beside it, in `.<name>.part`.
        size: that it has, bytes.
        sha256: of its content, hex.
        tell: called with the number of bytes that have arrived.

    Raises:
        DownloadError: it did not arrive, or is not the file that was expected.
        OSError: it cannot be written.
    """
    parts = urlsplit(url)
    if parts.scheme != "https" and parts.hostname not in _LOOPBACK:
        raise DownloadError("is no address of HTTPS")
    place.parent.mkdir(parents=True, exist_ok=True)
    part = place.with_name(f".{place.name}.part")
    byte_count = part.stat().st_size if part.is_file() else 0
    if byte_count < size:
        byte_count = _append(url, part, byte_count, size, tell)
    if byte_count < size:
        raise DownloadError(f"was cut off at {byte_count:,} of {size:,} bytes: the same command goes on from there")
    if byte_count > size or hash_file(part) != sha256:
        part.unlink()
        raise DownloadError("is another file than the one with which claims were measured: its SHA-256 or size differs")
    part.replace(place)


def _append(url: str, part: Path, offset: int, size: int, tell: Callable[[int], None]) -> int:
    """Appends what the server has from `offset` on, or all of it if it gives no parts; the bytes of the part then."""
    before = offset
    request = urllib.request.Request(url, headers={"Range": f"bytes={offset}-"} if offset else {})
    try:
        with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as reply:
            goes_on = reply.status == _PARTIAL and reply.headers.get("Content-Range", "").startswith(f"bytes {offset}-")
            offset = offset if goes_on else 0
            with part.open("ab" if goes_on else "wb") as file:
                while offset <= size and (block := reply.read(_BLOCK)):
                    offset += file.write(block)
                    tell(offset)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == _NOTHING_LEFT and offset:
            part.unlink()
            return _append(url, part, 0, size, tell)
        raise DownloadError(f"was refused: {error.code} {error.reason}") from None
    except (urllib.error.URLError, http.client.HTTPException, ConnectionError, TimeoutError) as error:
        if offset == before:
            raise DownloadError(f"cannot be reached ({getattr(error, 'reason', error)})") from None
    return offset
