"""Runs `benchmarks/devices/catheter.py`: two devices against theory, their stability, speed and forces."""

from __future__ import annotations

import runpy
from pathlib import Path

if __name__ == "__main__":
    runpy.run_path(str(Path(__file__).parent / "devices" / "catheter.py"), run_name="__main__")
