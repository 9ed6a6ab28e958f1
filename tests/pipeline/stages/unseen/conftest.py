"""Tests of the stage `unseen` share a cache of anatomies."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def own_cache(anatomy_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CATHSIM_CACHE", str(anatomy_cache))
