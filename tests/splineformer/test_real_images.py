"""The shipped network on real X-ray images of a wire in a phantom, where they are, and on one that is drawn."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.comparison.fluoroscopy_figures import curve_figures
from splineformer.predictor import Predictor

ROOT = Path(__file__).parents[2]
REAL = next(
    (place / "shared" / "real" for place in (ROOT.parent, ROOT.parent.parent) if (place / "shared").is_dir()), None
)
PLAIN = FluoroscopySettings(clutter=1e-6, contrast=0.0, catheter=0.0, two_devices=0.0, no_wire=0.0, weakest=0.7)


def test_a_drawn_wire_is_read() -> None:
    wire = np.column_stack([np.linspace(420, 1060, 200), 500 + 60 * np.sin(np.linspace(0, 3, 200))])
    image = RandomFluoroscopy(PLAIN, seed=1_000_003).along(0, [wire]).image
    prediction = Predictor.pretrained()(image)
    assert prediction.wires == "one"
    figures = curve_figures(prediction.points(), wire[wire[:, 0] <= 1023])
    assert figures["curve_px"] < 10
    assert figures["tip_px"] < 10


def test_the_benchmark_of_real_images_stays_near_its_figures() -> None:
    if REAL is None or not (REAL / "xray_wires").is_dir():
        pytest.skip("the real X-ray images (shared/real/xray_wires beside the project) are not here")
    words = ["benchmarks/splineformer/xray_curves.py", "--images", "0", "--alone"]
    done = subprocess.run(
        [sys.executable, *words, "--real", str(REAL / "xray_wires"), str(REAL / "stereo_pairs.json")],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["images"] == 12
    assert found["missed"] == 0
    assert found["curve_median_px"] < 6
    assert found["tip_median_px"] < 8
