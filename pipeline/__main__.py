"""Command line of the stages: ``python -m pipeline stage=phantoms``; ``--help`` lists stages and budgets."""

from __future__ import annotations

import sys

if __name__ == "__main__":
    try:
        from pipeline.launch import main

        code = main(sys.argv[1:])
    except KeyboardInterrupt:  # also while the imports above still run
        print("interrupted before the work began", file=sys.stderr)
        code = 130
    sys.exit(code)
