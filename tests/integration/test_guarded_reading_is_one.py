"""The guards for files from outside are one module, which packages that import nothing of each other carry alike."""

from __future__ import annotations

from pathlib import Path


def test_packages_carry_the_same_guards():
    root = Path(__file__).resolve().parents[2]
    copies = sorted(root.glob("packages/*/src/*/guarded_reading.py"))
    assert root / "packages/cathsim/src/cathsim/guarded_reading.py" in copies
    assert len({copy.read_bytes() for copy in copies}) == 1
