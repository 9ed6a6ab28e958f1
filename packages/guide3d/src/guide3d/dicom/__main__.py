"""Command line of DICOM: python -m guide3d.dicom FILE [FILE_B] --output FOLDER."""

import sys

from guide3d.dicom.command import main

if __name__ == "__main__":
    sys.exit(main())
