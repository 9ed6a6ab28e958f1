"""What commands print and refuse, also where the reader has gone, as `head` does; how texts write a command."""

from __future__ import annotations

import argparse
import os
import sys
import unicodedata
from typing import Any, NoReturn

EXIT_USAGE = 2

_HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}  # categories of letters that command a terminal, or turn the text's direction


def visible(text: str) -> str:
    r"""A text of a file as one line that no terminal takes for a command: an escape becomes `\x1b`."""
    if text.isprintable():
        return text
    letters = (one.encode("unicode_escape").decode() if unicodedata.category(one) in _HIDDEN else one for one in text)
    return "".join(letters)


CALLED = "ENDONAV_CALLED"  # in the environment, so that processes that a command starts write it the same way
_IN_A_CLONE = {
    "stages": "python -m pipeline",
    "chain": "python -m pipeline.chain",
    "episodes": "python -m pipeline.episodes",
    "demo": "python -m pipeline.demo",
    "console": "python -m pipeline.console",
}
_EXTRAS = {"make setup": "pip install 'endonav[learning]'", "make ray": "pip install 'endonav[ray]' hydra-ray-launcher"}


def say(text: str, *, error: bool = False) -> None:
    """Prints a text and its line end; where nobody reads any more, it and all that follows are dropped.

    A stream that cannot be written, as a file on a full disk, ends the program with exit code 1.
    """
    stream = sys.stderr if error else sys.stdout
    if stream is None:  # the program was started with it closed
        return
    lines = "\n".join("\t".join(map(visible, line.split("\t"))) for line in text.rstrip().split("\n"))
    try:
        stream.write(f"{lines}\n")  # at once: threads may print, too
        stream.flush()
    except OSError as failure:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())  # else Python complains again at its end
        os.close(nowhere)
        if not isinstance(failure, BrokenPipeError):
            sys.exit(f"what the command prints cannot be written: {failure.strerror}")


def written(command: str) -> str:
    """A command of `endonav`, such as ``episodes``, as the user would type it."""
    return f"endonav {command}" if CALLED in os.environ else _IN_A_CLONE[command]


def installing(verb: str) -> str:
    """A verb of the Makefile that installs something, or what does the same without a clone."""
    return _EXTRAS[verb] if CALLED in os.environ else verb


class Parser(argparse.ArgumentParser):
    """Refuses wrong arguments in one line, without the list of all of them."""

    def _print_message(self, message: str, file: Any = None) -> None:  # argparse has no other way in
        if message:
            say(message, error=file is not sys.stdout)

    def error(self, message: str) -> NoReturn:
        """Ends the program with exit code 2."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message} (--help lists what there is)\n")
