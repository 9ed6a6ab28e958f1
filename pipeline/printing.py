"""What commands print, also where the reader has gone, as `head` does after a few lines."""

from __future__ import annotations

import os
import sys


def say(text: str, *, error: bool = False) -> None:
    """Prints a text and its line end; where nobody reads any more, it and all that follows are dropped."""
    stream = sys.stderr if error else sys.stdout
    try:
        stream.write(f"{text.rstrip()}\n")  # at once: threads may print, too
        stream.flush()
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())  # else Python complains again at its end
        os.close(nowhere)
