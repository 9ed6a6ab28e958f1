"""Processes of this machine: Ctrl-C while they are being started."""

from __future__ import annotations

import subprocess
import sys

from pipeline.jobs.engines.local import ctrl_c_held_back

_INTERRUPT_ITSELF = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"
_INTERRUPTED_MEANWHILE = """
import os, signal
from pipeline.jobs.engines.local import ctrl_c_held_back

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job comes without it
try:
    with ctrl_c_held_back():
        os.kill(os.getpid(), signal.SIGINT)
        print("held back")
except KeyboardInterrupt:
    print("interrupted", signal.pthread_sigmask(signal.SIG_BLOCK, ()))
"""


def test_a_ctrl_c_while_processes_start_is_not_lost() -> None:
    process = subprocess.run([sys.executable, "-c", _INTERRUPTED_MEANWHILE], capture_output=True, text=True, check=True)
    assert process.stdout == "held back\ninterrupted set()\n"


def test_what_is_started_does_not_see_it() -> None:
    with ctrl_c_held_back():
        process = subprocess.run([sys.executable, "-c", _INTERRUPT_ITSELF], capture_output=True, text=True, check=False)
    assert (process.stdout, process.stderr, process.returncode) == ("alive\n", "", 0)
