"""Names of a package that are imported at first use, so that importing the package itself stays light."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any


def imported(package: str, home: Mapping[str, str], name: str) -> Any:
    """What a package's ``__getattr__`` gives for a name; `home`: name to the module, below the package, that has it.

    Raises:
        AttributeError: the package has no such name.
    """
    if name in home:
        return getattr(importlib.import_module(f"{package}.{home[name]}"), name)
    raise AttributeError(f"module '{package}' has no attribute '{name}'")
