"""Paths among Hydra's overrides: their brackets, commas, quotes and letters beyond ASCII mean themselves.

Hydra reads `key=value` by a grammar of its own, in which `a,b` is a sweep, `[a]` a list and `${a}` another setting.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import OverrideParseException

_PLAIN = re.compile(r"[\w./-]*", re.ASCII)
_MADE = ("runs_dir",)  # paths that a run makes


def with_quoted_paths(words: Sequence[str]) -> list[str]:
    """A command line whose paths Hydra reads as they stand: of files that exist, of ~/…, of folders to be made."""
    return [_with_quoted_path(word) for word in words]


def _with_quoted_path(word: str) -> str:
    key, equals, value = word.partition("=")
    if not equals or _PLAIN.fullmatch(value) or value[:1] in ("'", '"'):
        return word
    if value.startswith("~/"):  # which a shell leaves as it is behind `key=`
        return f"{key}={quoted(str(Path(value).expanduser()))}"
    made = key in _MADE and "${" not in value  # which is another setting there
    return f"{key}={quoted(value)}" if made or _exists(value) else word


def _exists(value: str) -> bool:
    try:
        return Path(value).exists()
    except (OSError, ValueError):  # no path at all
        return False


def quoted(value: str) -> str:
    """A text as Hydra reads it back: in quotes, no other setting in it."""
    return str(QuotedString(value.replace("${", r"\${"), Quote.single).with_quotes())


def unquoted(value: str) -> str:
    """The text that `quoted` was given; another value as it is."""
    if value[:1] not in ("'", '"'):
        return value
    try:
        return str(OverridesParser.create().parse_override(f"key={value}").value()).replace(r"\${", "${")
    except OverrideParseException:
        return value


def chosen_value(overrides: Sequence[str], key: str, default: str) -> str:
    """The value of a setting among overrides: the last one counts."""
    values = (word.partition("=")[2] for word in reversed(with_quoted_paths(overrides)) if word.startswith(f"{key}="))
    return next(map(unquoted, values), default)


def advice(word: str) -> str:
    """How an override that Hydra cannot read is written, for the shell."""
    key, _, value = word.partition("=")
    written = f"{key}={quoted(unquoted(value))}"
    return shlex.quote(written) if re.search(r'["$`!]|\\\\', written) else f'"{written}"'
