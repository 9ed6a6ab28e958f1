"""Command line of the stages: ``python -m pipeline stage=phantoms``; ``--help`` lists stages and budgets."""

from __future__ import annotations

import sys

from pipeline.early_stop import stop_at_once_by_ctrl_c

if __name__ == "__main__":
    stop_at_once_by_ctrl_c()
    from pipeline.launch import main

    sys.exit(main(sys.argv[1:]))
