"""Files with the values of a volume whose header is a file of its own (.nhdr, .mhd)."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

HEADERS = (".nhdr", ".mhd")
_MOST_BYTES = 1 << 16
_DATA = re.compile(rb"^\s*(?:data ?file|elementdatafile)\s*[:=]\s*(.+?)\s*$", re.IGNORECASE | re.MULTILINE)


def with_detached_data(files: Iterable[Path]) -> list[Path]:
    """The same files, each header followed by the file that it names; without it where that is not there.

    Headers that name several files, by a list or a pattern, are followed by none.
    """
    found = []
    for file in files:
        found.append(file)
        if file.suffix.lower() in HEADERS and file.is_file():
            with file.open("rb") as header:
                named = _DATA.search(header.read(_MOST_BYTES))
            data = file.parent / named[1].decode(errors="replace") if named else file
            if data != file and os.path.isfile(data):  # False, too, for a name that no file can have
                found.append(data)
    return found
