"""Optional dependencies: what is missing is named with the extra that brings it."""

from __future__ import annotations

import importlib.util
import sys


def require(module: str, extra: str) -> None:
    """Makes sure that an optional dependency is installed, without importing it.

    Raises:
        ModuleNotFoundError: it is not; the message has the command that installs it.
    """
    if importlib.util.find_spec(module) is None:
        raise ModuleNotFoundError(
            f"this part of guide3d needs {module}: pip install 'endonav-guide3d[{extra}]'", name=module
        )


def required_by_command(command: str, module: str, extra: str) -> None:
    """As `require`, for a program of which even the imports need it: ends it with one line and exit code 1."""
    try:
        require(module, extra)
    except ModuleNotFoundError as error:
        sys.exit(f"{command}: {error}")
