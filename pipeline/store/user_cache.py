"""The user's cache: what is the same for all runs and may be deleted."""

from __future__ import annotations

import os
from pathlib import Path


def user_cache() -> Path:
    """The folder, which need not be there: $ENDONAV_CACHE, else `endonav` in the user's cache directory."""
    chosen = os.environ.get("ENDONAV_CACHE")
    if chosen:
        return Path(chosen).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return Path(base).expanduser() / "endonav"
