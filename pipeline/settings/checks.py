"""The one validator of settings: kind, finite, range; and what it refuses, as one sentence that names the setting.

A settings dataclass is declared with `validated` in place of `dataclasses.dataclass`. Its ranges stand in its
annotations (`pipeline.settings.kinds`), what several fields must agree on in ``__post_init__``. OmegaConf does not see
the ranges.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeVar, dataclass_transform

from pydantic import ConfigDict, ValidationError
from pydantic.dataclasses import dataclass

from pipeline.store.errors import ConfigurationError

# Metadata of a setting that changes how fast results come, never what they are: it stays out of the hash.
NO_EFFECT_ON_RESULTS = {"affects_results": False}

_STRICT = ConfigDict(allow_inf_nan=False, extra="forbid", validate_default=True)
_LONGEST_VALUE = 60  # characters of a value that are shown
_WORDS = {
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be {ge} or more",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be {le} or less",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "int_parsing_size": "must be a smaller number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text",
    "list_type": "must be a list",
}
_Settings = TypeVar("_Settings")


@dataclass_transform(field_specifiers=(dataclasses.field,))
def validated(prefix: str = "stage.") -> Callable[[type[_Settings]], type[_Settings]]:
    """Makes a class a dataclass whose values are validated.

    Args:
        prefix: what the user writes before each field's name.

    Returns:
        The decorator. The class's constructor raises a ConfigurationError of one sentence.
    """

    def declare(owner: type[_Settings]) -> type[_Settings]:
        made: Any = dataclass(config=_STRICT)(owner)
        validate = made.__init__

        @functools.wraps(validate)
        def construct(self: _Settings, *args: Any, **values: Any) -> None:
            try:
                validate(self, *args, **values)
            except ValidationError as error:
                raise ConfigurationError(sentence(error, prefix)) from error

        made.__init__ = construct
        result: type[_Settings] = made
        return result

    return declare


def sentence(error: ValidationError, prefix: str | None = None) -> str:
    """Words what a validator refused.

    Args:
        prefix: what the user writes before a field's name; the class's name and a dot when None.

    Returns:
        One sentence: the first setting that is wrong, what it must be, what came.
    """
    first = error.errors(include_url=False)[0]
    prefix = f"{error.title}." if prefix is None else prefix
    setting = prefix + ".".join(str(part) for part in first["loc"] if not isinstance(part, int))
    if first["type"] in ("value_error", "assertion_error"):  # of a check of ours, which says what came
        problem = str(first.get("ctx", {}).get("error", first["msg"]))
        return f"{setting} {problem}" if first["loc"] else problem
    if first["type"] == "unexpected_keyword_argument":
        return f"unknown setting {setting!r}"
    words = _WORDS.get(first["type"])
    if words is None:
        message = first["msg"].removeprefix("Input should ")
        return f"{setting} {'must ' + message if message != first['msg'] else 'is refused: ' + message}"
    bounds = {key: f"{bound:.15g}" for key, bound in first.get("ctx", {}).items() if isinstance(bound, int | float)}
    return f"{setting} {words.format(**bounds)}, got {shown(first['input'])}"


def shown(value: Any) -> str:
    """A value as an error shows it: text in quotes, long ones cut."""
    text = " ".join((repr(value) if isinstance(value, str) else str(value)).split())
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}…"


def require_modalities(*sets: str) -> None:
    """Refuses what is no set of modalities.

    Args:
        sets: as the user writes them, e.g. ``I+V+M``.

    Raises:
        ConfigurationError: listing the valid sets.
    """
    from enn.networks.features import modality_keys

    for modalities in sets:
        try:
            modality_keys(modalities)
        except ValueError as error:
            raise ConfigurationError(str(error)) from error


def settings_that_matter(settings: Any) -> dict[str, Any]:
    """Lists a stage's settings without those that cannot change its results."""
    everything = dataclasses.asdict(settings)
    return {
        item.name: everything[item.name]
        for item in dataclasses.fields(settings)
        if item.metadata.get("affects_results", True)
    }
