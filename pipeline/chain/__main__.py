"""``python -m pipeline.chain``."""

import sys

from pipeline.chain.command import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
