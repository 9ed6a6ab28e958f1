"""Command line of the stages: ``python -m pipeline stage=phantoms``; ``--help`` lists stages and budgets."""

from __future__ import annotations

import sys

from pipeline.store.interruption import stop_at_once_by_ctrl_c

if __name__ == "__main__":
    stop_at_once_by_ctrl_c()
    try:
        from pipeline.launch import main
    except ModuleNotFoundError as error:
        sys.exit(f"the module {error.name} is missing: run `make setup`, then `source .venv/bin/activate`")
    sys.exit(main(sys.argv[1:]))
