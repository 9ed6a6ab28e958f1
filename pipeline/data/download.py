"""Download of a file of a few megabytes by HTTPS, which appears in its place whole and verified by its SHA-256."""

from __future__ import annotations

import hashlib
import http.client
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

from pipeline.store.atomic_files import atomic_path

_TIMEOUT_S = 30
_LOOPBACK = ("127.0.0.1", "localhost")


class DownloadError(Exception):
    """Why a file did not arrive."""


def download(url: str, place: Path, size: int, sha256: str) -> None:
    """Downloads a file from an address of HTTPS, or of this machine.

    Args:
        size: that it has, bytes.
        sha256: of its content, hex.

    Raises:
        DownloadError: it did not arrive, or is not the file that was expected.
        OSError: it cannot be written.
    """
    parts = urlsplit(url)
    if parts.scheme != "https" and parts.hostname not in _LOOPBACK:
        raise DownloadError("is no address of HTTPS")
    try:
        with urllib.request.urlopen(url, timeout=_TIMEOUT_S) as reply:
            content = reply.read(size + 1)
    except urllib.error.HTTPError as error:
        error.close()
        raise DownloadError(f"was refused: {error.code} {error.reason}") from None
    except (urllib.error.URLError, http.client.HTTPException, ConnectionError, TimeoutError) as error:
        raise DownloadError(f"cannot be reached ({getattr(error, 'reason', error)})") from None
    if len(content) < size:
        raise DownloadError(f"was cut off at {len(content):,} of {size:,} bytes: the same command tries again")
    if hashlib.sha256(content).hexdigest() != sha256:
        raise DownloadError("is another file than the one with which claims were measured: its SHA-256 or size differs")
    with atomic_path(place) as temporary:
        temporary.write_bytes(content)
