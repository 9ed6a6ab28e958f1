"""The validator of settings: quantities with their units and ranges, and dataclasses that refuse what cannot be meant.

A field's annotation says which values it takes; the sentence of a refusal names field, range, unit and what came.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Set
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, dataclass_transform, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Interval
from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

Kind = TypeVar("Kind")

_HINTS = {
    "m": "lengths are in metres",
    "rad": "angles are in radians, np.radians(...) converts degrees",
    "s": "times are in seconds",
    "kg/m^3": "water has 1000 kg/m^3",
}
_KINDS = {
    **dict.fromkeys(("int_type", "int_from_float", "int_parsing"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "finite_number": "a finite number",
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


def require_saved(state: object, keys: Set[str]) -> None:
    """Refuses what an environment's `state` did not give.

    Raises:
        ValueError: it is no dictionary with these keys.
    """
    missing = sorted(keys - state.keys()) if isinstance(state, dict) else None
    if missing or missing is None:
        got = type(state).__name__ + (f" without {', '.join(missing)}" if missing else "")
        raise ValueError(f"expected what env.state() gave, got {got}: save a moment by env.state() first")


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def settings(cls: Any = None, *, frozen: bool = True, eq: bool = True) -> Any:
    """Makes a frozen dataclass whose fields are checked by their annotations.

    NaN and infinity are refused everywhere, ranges where an annotation has them. Numbers of NumPy are taken. `frozen`
    and `eq` are those of `dataclasses.dataclass`.

    Raises:
        ValueError: on construction, one sentence that names field, range and unit.
    """
    if cls is None:
        return functools.partial(settings, frozen=frozen, eq=eq)
    made: Any = dataclass(frozen=frozen, eq=eq, config=_CONFIGURATION)(cls)
    construct = made.__init__

    @functools.wraps(construct)
    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        pairs = zip((field.name for field in dataclasses.fields(made) if field.init), args, strict=False)
        for name, value in (*pairs, *kwargs.items()):
            if isinstance(value, bool):
                _refuse_truth(name, value, get_type_hints(made, include_extras=True).get(name))
        try:
            construct(self, *args, **kwargs)
        except ValidationError as error:
            raise ValueError(_refusal(made, error)) from None

    init.checks_fields = True  # type: ignore[attr-defined]
    made.__init__ = init
    return made


def check_fields(made: Any, of: type[Any]) -> None:
    """Checks the fields that an object has of the settings class `of`; for its `__post_init__`.

    A subclass that the standard library's decorator has made sets them without a check.

    Raises:
        ValueError: as `settings` raises it.
    """
    if getattr(type(made).__init__, "checks_fields", False):
        return
    for name, annotation in get_type_hints(of, include_extras=True).items():
        object.__setattr__(made, name, quantity(name, getattr(made, name), annotation))


def quantity(name: str, value: Any, annotation: Any) -> Any:
    """Checks an argument of a function as `settings` checks a field, and converts it to the annotation's type.

    Raises:
        ValueError: one sentence that names argument, range and unit.
    """
    if isinstance(value, bool):
        _refuse_truth(name, value, annotation)
    try:
        return _adapter(annotation).validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        own = first["ctx"]["error"] if first["type"] == "value_error" else None
        raise ValueError(str(own or _sentence(name, annotation, first))) from None


def named(what: str, name: str, known: Mapping[str, Kind]) -> Kind:
    """What is known by a name, such as a preset.

    Raises:
        ValueError: nothing is; the message says `what` was looked for, and which there are.
    """
    if name not in known:
        raise ValueError(f"unknown {what} '{name}'; there are {', '.join(known)}")
    return known[name]


def numbers(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Converts an argument to an array of float64.

    Args:
        name: with its article, such as "an action".
        shape: that it must have.

    Raises:
        ValueError: another shape, or no real numbers; a tensor that requires a gradient, or lies on a GPU.
    """
    expected = f"expected {name} of shape {shape}"
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise ValueError(f"{expected}, real numbers, got a {type(value).__name__}: {reason}") from None
    if array.shape != shape:
        raise ValueError(f"{expected}, got {array.shape if array.shape else repr(value)}")
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{expected}, real numbers, got {value!r}")
    return array.astype(np.float64)


def _refuse_truth(name: str, value: bool, annotation: Any) -> None:
    """Refuses True and False for a number, which they would become."""
    kinds = _kinds(annotation)
    if kinds & {int, float} and bool not in kinds:
        expected = "float_type" if float in kinds else "int_type"
        raise ValueError(_sentence(name, annotation, {"type": expected, "input": value}))


def _kinds(annotation: Any) -> set[Any]:
    """The types that an annotation takes, of lists none."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _kinds(get_args(annotation)[0])
    if origin in (Union, UnionType):
        return set().union(*map(_kinds, get_args(annotation)))
    return {annotation}


@functools.cache
def _adapter(annotation: Any) -> TypeAdapter[Any]:
    return TypeAdapter(annotation, config=ConfigDict(allow_inf_nan=False))


def _refusal(cls: type[Any], error: ValidationError) -> str:
    """One sentence for what a validator found first in a dataclass."""
    first = error.errors(include_url=False)[0]
    if first["type"] == "value_error":  # of a check in the class itself, which has written its own sentence
        return str(first["ctx"]["error"])
    place = [part for part in first["loc"] if isinstance(part, int) or str(part).isidentifier()]
    if place and isinstance(place[0], int):  # an argument given by its position
        place[0] = [one.name for one in dataclasses.fields(cls) if one.init][place[0]]
    name = str(place[0]) if place else cls.__name__
    if first["type"] == "missing":
        return f"{cls.__name__} needs {name}"
    if first["type"] == "unexpected_keyword_argument":
        return f"{cls.__name__} has no {name}; its fields are {', '.join(one.name for one in dataclasses.fields(cls))}"
    annotation, field_path = get_type_hints(cls, include_extras=True).get(name), name
    for index in (part for part in place[1:] if isinstance(part, int)):
        field_path += f"[{index}]"
        annotation = _entry(annotation, index)
    return _sentence(field_path, annotation, first)


def _entry(annotation: Any, index: int) -> Any:
    """The annotation of a tuple's entry, within whatever stands about the tuple; itself where there is none."""
    kinds = get_args(annotation)
    if get_origin(annotation) is tuple:
        return kinds[0] if kinds[-1] is Ellipsis else kinds[index]
    inner = (_entry(kind, index) for kind in kinds)
    return next((found for kind, found in zip(kinds, inner, strict=True) if found is not kind), annotation)


def _sentence(name: str, annotation: Any, first: Any) -> str:
    """One sentence for what a validator found wrong with a value."""
    kind, came = first["type"], first.get("input")
    low, high, unit = _range(annotation)
    if kind == "too_short":
        return f"{name} needs at least {first['ctx']['min_length']} entries, got {first['ctx']['actual_length']}"
    if kind in _KINDS:
        return f"{name} must be {_KINDS[kind]}{f' ({unit})' if unit else ''}, got {came!r}"
    if kind.startswith(("greater_than", "less_than")):
        range_ = f"lie in {low} to {high}" if low and high else f"be at least {low}" if low else f"be at most {high}"
        hint = f"; {_HINTS[unit]}" if unit in _HINTS and kind.startswith("less") else ""
        return f"{name} must {range_}{f' {unit}' if unit else ''}, got {came!r}{hint}"
    return f"{name}: {first['msg'][:1].lower()}{first['msg'][1:]}, got {came!r}"


def _range(annotation: Any) -> tuple[str, str, str]:
    """Bounds and unit of the first quantity within an annotation, as text; empty where there is none."""
    bounds, unit = {"g": "", "l": ""}, ""
    for part in getattr(annotation, "__metadata__", ()):
        for bound in part if isinstance(part, Interval) else (part,):
            for edge in ("ge", "gt", "le", "lt"):
                if hasattr(bound, edge):
                    value, excluded = getattr(bound, edge), " (excluded)" if edge[1] == "t" else ""
                    bounds[edge[0]] = (f"{value:g}" if isinstance(value, float) else str(value)) + excluded
        unit = part.name if isinstance(part, Unit) else unit
    if any(bounds.values()) or unit:
        return bounds["g"], bounds["l"], unit
    return next(filter(any, map(_range, getattr(annotation, "__args__", ()))), ("", "", ""))
