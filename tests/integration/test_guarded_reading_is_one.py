"""Modules that packages which import nothing of each other carry alike: guards for files, lazy names, OpenCV."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("guarded_reading.py", "cathsim/src/cathsim"),
        ("bounded_content.py", "enn/src/enn"),
        ("lazy_names.py", "guide3d/src/guide3d"),
        ("opencv.py", "guide3d/src/guide3d"),
    ],
)
def test_packages_carry_the_same_module(name: str, package: str):
    copies = sorted((ROOT / "packages").glob(f"*/src/**/{name}"))
    assert ROOT / "packages" / package / name in copies
    assert len(copies) > 1
    assert len({copy.read_bytes() for copy in copies}) == 1
