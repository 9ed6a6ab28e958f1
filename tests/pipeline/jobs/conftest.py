"""A stage's folder, as its jobs find it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.store.run_folder import Identity, RunFolder


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    """Locked and prepared."""
    folder = RunFolder(tmp_path / "stage", Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        yield folder
