"""Processes of this machine: Ctrl-C while they are being started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from pipeline.jobs.engines.local import ctrl_c_held_back

_INTERRUPT_ITSELF = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"


def test_a_ctrl_c_while_processes_start_is_not_lost() -> None:
    with pytest.raises(KeyboardInterrupt), ctrl_c_held_back():
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_what_is_started_does_not_see_it() -> None:
    with ctrl_c_held_back():
        process = subprocess.run([sys.executable, "-c", _INTERRUPT_ITSELF], capture_output=True, text=True, check=False)
    assert (process.stdout, process.stderr, process.returncode) == ("alive\n", "", 0)
