"""JSON files, as others write them: what cannot be read is one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def read_json(path: Path, what: str) -> Any:
    """Reads a file; `what` it is, for messages: "annotation file".

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no JSON, or nested deeper than any file of a data set.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileNotFoundError(f"{what} {path} is missing") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: expected JSON, but it cannot be read ({error})") from None
