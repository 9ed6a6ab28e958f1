"""JSON of files and of command lines, as others write it: what cannot be read is one sentence."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from guide3d.text_file import read_text


def read_json(path: Path, what: str) -> Any:
    """Reads a file; `what` it is, for messages: "annotation file".

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no regular file, no JSON, or nested deeper than any file of a data set.
    """
    text = read_text(path, what)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: expected JSON, but it cannot be read ({error})") from None


def json_fields(text: str) -> dict[str, Any]:
    """What an option that changes fields of settings gives: a JSON object; argparse refuses anything else."""
    try:
        content = json.loads(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"expected a JSON object of fields: {error}") from None
    if not isinstance(content, dict):
        raise argparse.ArgumentTypeError(f"expected a JSON object of fields, got {text}")
    return content
