"""What is shipped and public: networks by name, threads of OpenCV, names."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import guide3d
from guide3d import shipped
from guide3d.learning.model_file import read_content, write_content

SHIPPED = Path(shipped.__file__).parent / "weights"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of the installed weights, with a copy of the reader."""
    monkeypatch.setattr(shipped, "files", lambda package: tmp_path / package)
    weights = tmp_path / "guide3d.weights"
    weights.mkdir()
    (weights / "reader.pt").write_bytes((SHIPPED / "reader.pt").read_bytes())
    (weights / "reader.md").write_text("# reader\n\nReads\nwires.\n\nmore\n")
    return weights


def test_networks_of_the_data_set_predict() -> None:
    image = np.full((1024, 1024), 150, np.uint8)
    image[:600, 510:515] = 40
    mask = guide3d.load("unet").predict(image)
    assert mask.shape == (1024, 1024)
    assert (mask[100:500, 508:517] > 0).mean() > 0.5
    assert (mask[:, :400] > 0).mean() < 0.01
    curve = guide3d.load("shape").predict([image] * 3)
    assert curve.shape[1] == 3
    assert np.linalg.norm(np.diff(curve, axis=0), axis=1) == pytest.approx(1.7, abs=0.1)


def rename_format(path: Path) -> None:
    write_content(path, {**read_content(path), "format": "guide3d-network-0"})


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def test_kinds_and_formats_are_refused_by_name(folder: Path) -> None:
    refusals: list[tuple[Callable[[Path], None], str]] = [
        (rename_format, r"'reader' has format guide3d-network-0, but guide3d 0\.1\.0 reads guide3d-network-1: install"),
        (cut, "reader.pt is damaged or no network"),
    ]
    for change, message in refusals:
        change(folder / "reader.pt")
        with pytest.raises(ValueError, match=message):
            guide3d.load("reader")


@pytest.mark.parametrize("use", [guide3d.load, shipped.card])
def test_an_unknown_name_is_refused_with_the_known_ones(folder: Path, use: Callable[[str], object]) -> None:
    with pytest.raises(ValueError, match="there is no model 'unet9': choose from reader"):
        use("unet9")


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"OMP_NUM_THREADS": "1"}, 1),
        ({"OMP_NUM_THREADS": "3"}, 3),
        ({"OMP_NUM_THREADS": "3", "OPENCV_FOR_THREADS_NUM": "2"}, 2),
        ({"OMP_NUM_THREADS": "4,2"}, None),  # OpenMP's own form for nested loops: left to OpenCV
        ({}, None),
    ],
)
def test_threads_follow_the_environment(environment: dict[str, str], expected: int | None) -> None:
    kept = {name: value for name, value in os.environ.items() if not name.endswith(("NUM_THREADS", "THREADS_NUM"))}
    snippet = "import cv2; own = cv2.getNumThreads(); import guide3d.opencv; print(own, cv2.getNumThreads())"
    run = subprocess.run([sys.executable, "-c", snippet], env={**kept, **environment}, capture_output=True, check=True)
    own, followed = (int(word) for word in run.stdout.split())
    assert followed == (own if expected is None else expected)


def test_the_function_read_stays_one_when_its_command_is_imported() -> None:
    code = "import guide3d, guide3d.read as first; import guide3d.read; assert first is guide3d.read; print(first)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("<function read")


def test_the_calibration_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "guide3d.calibration", "--help"], capture_output=True, text=True, check=True
    )
    assert "--output" in done.stdout
