"""Command line of calibration: python -m guide3d.calibration DIR --output FOLDER."""

import sys

from guide3d.calibration.report import main

if __name__ == "__main__":
    sys.exit(main())
