"""Command line of the console: `python -m cathsim.console --help`."""

from __future__ import annotations

import sys

from cathsim.console.launch import main

if __name__ == "__main__":
    sys.exit(main())
