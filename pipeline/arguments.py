"""The parser of a command line whose wrong arguments are one sentence."""

from __future__ import annotations

import argparse
from typing import NoReturn

EXIT_USAGE = 2


class Parser(argparse.ArgumentParser):
    """Refuses wrong arguments in one line, without the list of all of them."""

    def error(self, message: str) -> NoReturn:
        """Ends the program with exit code 2."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message} (--help lists what there is)\n")
