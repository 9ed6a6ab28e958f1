"""The real X-ray images, calibrations and annotated pairs beside the project, where they are."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
REAL = next(
    (place / "shared" / "real" for place in (ROOT.parent, ROOT.parent.parent) if (place / "shared").is_dir()), None
)


def real_folder() -> Path:
    """Their folder; skips the test where it is not there."""
    if REAL is None or not (REAL / "xray_wires").is_dir():
        pytest.skip("the real X-ray images (shared/real/xray_wires beside the project) are not here")
    return REAL


def write_some_pairs(folder: Path) -> Path:
    """Writes a file of every second of the annotated pairs."""
    told = json.loads((real_folder() / "stereo_pairs.json").read_text())
    (folder / "pairs.json").write_text(json.dumps(told | {"pairs": told["pairs"][::2]}))
    return folder / "pairs.json"
