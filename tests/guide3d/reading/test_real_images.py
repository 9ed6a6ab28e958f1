"""Real X-ray images of a wire in a phantom, where they are: loose limits of what the shipped reader reaches on them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
REAL = next(
    (place / "shared" / "real" for place in (ROOT.parent, ROOT.parent.parent) if (place / "shared").is_dir()), None
)


def test_the_benchmark_of_real_images_stays_near_its_figures() -> None:
    if REAL is None or not (REAL / "xray_wires").is_dir():
        pytest.skip("the real X-ray images (shared/real/xray_wires beside the project) are not here")
    words = ["benchmarks/guide3d/real_xray.py", str(REAL / "xray_wires"), str(REAL / "stereo_pairs.json")]
    done = subprocess.run(
        [sys.executable, *words, "--cameras", str(REAL / "xray_calibration")],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["images"] == 12
    assert found["missed"] == 0
    assert found["dice"] > 0.85
    assert found["within_4px_pct"] > 97
    assert found["tip_median_px"] < 6
    assert found["pair_mean_mm"] < 1.0
    assert found["pair_tip_median_mm"] < 2.0
