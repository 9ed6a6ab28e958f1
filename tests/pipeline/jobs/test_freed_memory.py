"""What a process has freed goes back to the system."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

SCRIPT = """
import gc
from pathlib import Path
import mujoco
from pipeline.jobs.worker import map_simulations, return_freed_memory

def taken():
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmData")).split()[1]) / 1e3

def resident():
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("RssAnon")).split()[1]) / 1e3

map_simulations()
model = mujoco.MjModel.from_xml_string('<mujoco><size memory="16M"/></mujoco>')
for _ in range(3):  # what was freed before would move the C library's own threshold
    data = mujoco.MjData(model)
    del data
before, data = taken(), [mujoco.MjData(model) for _ in range(20)]
kept = data[-1]
data = None
gc.collect()
print(taken() - before)

many = [b"x" * (100_000 + k) for k in range(3000)]
kept, many = many[::100], None
before = resident()
return_freed_memory()
print(before - resident())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries return memory by themselves")
def test_freed_memory_goes_back() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    left, returned = (float(line) for line in done.stdout.split())
    assert returned > 200  # MB of 297
    assert left < 40  # MB: one arena of 20
