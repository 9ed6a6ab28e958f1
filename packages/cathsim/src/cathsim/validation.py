"""The validator of settings: quantities with their units and ranges, and dataclasses that refuse what cannot be meant.

A field's annotation says which values it takes; the sentence of a refusal names field, range, unit and what came.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Annotated, Any, TypeVar, cast, dataclass_transform, get_type_hints

import numpy as np
from annotated_types import Ge, Gt, Interval, Le, Lt
from pydantic import BeforeValidator, ConfigDict, ValidationError
from pydantic.dataclasses import dataclass

Kind = TypeVar("Kind")

_HINTS = {
    "m": "lengths are in metres",
    "rad": "angles are in radians, np.radians(...) converts degrees",
    "s": "times are in seconds",
    "kg/m^3": "water has 1000 kg/m^3",
}
_KINDS = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text",
    "tuple_type": "a list",
}


@dataclasses.dataclass(frozen=True)
class Unit:
    """The unit of a quantity, in its annotation."""

    name: str


def _listed(value: Any) -> Any:
    return tuple(value.tolist()) if isinstance(value, np.ndarray) and value.ndim else value


Listed = BeforeValidator(_listed)  # in an annotation: an array is taken like a list

TURN = 2 * math.pi
Angle = Annotated[float, Interval(ge=-TURN, le=TURN), Unit("rad")]
Turn = Annotated[float, Interval(ge=0, le=TURN), Unit("rad")]  # an angle without a sign
Share = Annotated[float, Interval(ge=0, le=1)]
Count = Annotated[int, Interval(ge=1, le=1_000_000)]
Seed = Annotated[int, Interval(ge=0, lt=2**63)]
Pixels = Annotated[int, Interval(ge=1, le=8192), Unit("px")]  # of an image's side
Length = Annotated[float, Interval(gt=0, le=10), Unit("m")]  # beyond any room that a patient lies in
LengthOrNone = Annotated[float, Interval(ge=0, le=10), Unit("m")]  # also 0
Coordinate = Annotated[float, Interval(ge=-10, le=10), Unit("m")]


_CONFIGURATION = ConfigDict(allow_inf_nan=False, arbitrary_types_allowed=True, extra="forbid")


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def settings(cls: type[Kind]) -> type[Kind]:
    """Makes a frozen dataclass whose fields are checked by their annotations.

    NaN and infinity are refused everywhere, ranges where an annotation has them. Numbers of NumPy are taken.

    Raises:
        ValueError: on construction, one sentence that names field, range and unit.
    """
    made: Any = dataclass(frozen=True, config=_CONFIGURATION)(cls)
    construct = made.__init__

    @functools.wraps(construct)
    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        try:
            construct(self, *args, **kwargs)
        except ValidationError as error:
            raise ValueError(refusal(made, error)) from None

    made.__init__ = init
    return cast(type[Kind], made)


def refusal(cls: type[Any], error: ValidationError) -> str:
    """One sentence for what a validator found first.

    Args:
        cls: whose field it is.
        error: as pydantic raised it.
    """
    first = error.errors(include_url=False)[0]
    kind, came = first["type"], first.get("input")
    if kind == "value_error":  # of a check in the class itself, which has written its own sentence
        return str(first["ctx"]["error"])
    place = [part for part in first["loc"] if isinstance(part, int) or str(part).isidentifier()]
    name = str(place[0]) if place else cls.__name__
    shown = name + "".join(f"[{part}]" for part in place[1:] if isinstance(part, int))
    if kind == "missing":
        return f"{cls.__name__} needs {name}"
    if kind == "unexpected_keyword_argument":
        return f"{cls.__name__} has no {name}; its fields are {', '.join(one.name for one in dataclasses.fields(cls))}"
    low, high, unit = _range(get_type_hints(cls, include_extras=True).get(name))
    if kind in _KINDS:
        return f"{shown} must be {_KINDS[kind]}{f' ({unit})' if unit else ''}, got {came!r}"
    if kind.startswith(("greater_than", "less_than")):
        range_ = f"lie in {low} to {high}" if low and high else f"be at least {low}" if low else f"be at most {high}"
        hint = f"; {_HINTS[unit]}" if unit in _HINTS and kind.startswith("less") else ""
        return f"{shown} must {range_}{f' {unit}' if unit else ''}, got {came!r}{hint}"
    return f"{shown}: {first['msg'][:1].lower()}{first['msg'][1:]}, got {came!r}"


def _range(annotation: Any) -> tuple[str, str, str]:
    """Bounds and unit of the first quantity within an annotation, as text; empty where there is none."""
    low = high = unit = ""
    edge: Any
    for part in getattr(annotation, "__metadata__", ()):
        for bound in part if isinstance(part, Interval) else (part,):
            if isinstance(bound, Ge | Gt):
                edge = bound.ge if isinstance(bound, Ge) else bound.gt
                low = _number(edge) + (" (excluded)" if isinstance(bound, Gt) else "")
            elif isinstance(bound, Le | Lt):
                edge = bound.le if isinstance(bound, Le) else bound.lt
                high = _number(edge) + (" (excluded)" if isinstance(bound, Lt) else "")
        if isinstance(part, Unit):
            unit = part.name
    if low or high or unit:
        return low, high, unit
    for inner in getattr(annotation, "__args__", ()):
        if any(found := _range(inner)):
            return found
    return "", "", ""


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
