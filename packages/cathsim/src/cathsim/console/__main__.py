"""Command line of the console: `python -m cathsim.console --help`."""

from __future__ import annotations

from cathsim.__main__ import run
from cathsim.console.launch import main

if __name__ == "__main__":
    run(main)
