"""Real X-ray images of a wire in a phantom, where they are: loose limits of what the shipped reader reaches on them."""

from pathlib import Path

import pytest

from pipeline.protocol.claims import read_protocol
from pipeline.protocol.run import KINDS, summary

ROOT = Path(__file__).parents[3]
REAL = next(
    (place / "shared" / "real" for place in (ROOT.parent, ROOT.parent.parent) if (place / "shared").is_dir()), None
)


@pytest.fixture(autouse=True)
def data(monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder of data is that of the real images."""
    if REAL is None or not (REAL / "xray_wires").is_dir():
        pytest.skip("the real X-ray images (shared/real/xray_wires beside the project) are not here")
    monkeypatch.setenv("ENDONAV_DATA", str(REAL))


def test_pairs_are_read_near_their_figures() -> None:
    claim = read_protocol().claims["real_xray"]
    cases = [case for case in KINDS[claim.kind].cases(claim, 0) if case["variation"] == "size 1"]
    found = summary([case | KINDS[claim.kind].play(claim, case) for case in cases])
    assert found["cases"] == 6
    assert found["success_pct"]["mean"] == 100
    assert found["dice_mean"]["mean"] > 0.85
    assert found["within_4px_pct_mean"]["mean"] > 97
    assert found["tip_px_mean"]["mean"] < 8
    assert found["mean_mm_mean"]["mean"] < 1.0
    assert found["tip_mm_mean"]["mean"] < 3.0
