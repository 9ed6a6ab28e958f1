"""Command line of the demo: ``python -m pipeline.demo``; `make demo` calls it."""

from __future__ import annotations

import sys

from pipeline.demo.command import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
