"""Settings: dataclasses checked by their annotations, and annotations with the range of each kind of value.

NaN and infinity are refused everywhere. The upper bounds are far above what any use needs; they refuse slips of a unit
or of a zero before work is spent.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
from typing import Annotated, Any, dataclass_transform

import numpy as np
from annotated_types import Interval
from pydantic import BeforeValidator, ConfigDict, ValidationError
from pydantic.dataclasses import dataclass

Count = Annotated[int, Interval(ge=1, le=1_000_000_000)]
CountOrNone = Annotated[int, Interval(ge=0, le=1_000_000_000)]  # 0: none, or without a limit
Units = Annotated[int, Interval(ge=1, le=65_536)]  # of a layer
UnitsOrNone = Annotated[int, Interval(ge=0, le=65_536)]
Layers = Annotated[int, Interval(ge=1, le=1000)]
LayersOrNone = Annotated[int, Interval(ge=0, le=1000)]
Pixels = Annotated[int, Interval(ge=1, le=8192)]  # of a side
PixelsOrNone = Annotated[int, Interval(ge=0, le=8192)]
PixelDistance = Annotated[float, Interval(gt=0, le=8192)]
PixelDistanceOrNone = Annotated[float, Interval(ge=0, le=8192)]
Grey = Annotated[float, Interval(ge=0, le=255)]  # a difference of grey values
Millimetres = Annotated[float, Interval(gt=0, le=10_000)]
Angle = Annotated[float, Interval(ge=-13, le=13)]  # rad, two turns
Share = Annotated[float, Interval(ge=0, le=1)]
Dropout = Annotated[float, Interval(ge=0, lt=1)]
LearningRate = Annotated[float, Interval(gt=0, le=10)]
Weight = Annotated[float, Interval(ge=0, le=1e6)]  # of a term of a sum
Positive = Annotated[float, Interval(gt=0, le=1e6)]
Logarithm = Annotated[float, Interval(ge=0, le=10)]  # of a factor
SEEDS = range(2**31)
Numbers = Annotated[np.ndarray, BeforeValidator(np.asarray)]


def seed(text: str) -> int:
    """A seed as a command line gives it.

    Raises:
        argparse.ArgumentTypeError: it is no whole number, or out of range.
    """
    if not text.isdecimal() or int(text) not in SEEDS:
        raise argparse.ArgumentTypeError(f"a seed is a whole number from 0 to {SEEDS[-1]}, got {text!r}")
    return int(text)


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def settings(cls: Any = None, /, *, eq: bool = True) -> Any:
    """Makes a frozen dataclass that raises a ValueError of one sentence for what a field does not take.

    Args:
        eq: whether its instances are equal when their fields are; not of arrays.
    """
    if cls is None:
        return functools.partial(settings, eq=eq)
    configuration = ConfigDict(allow_inf_nan=False, arbitrary_types_allowed=True, extra="forbid")
    made: Any = dataclass(frozen=True, eq=eq, config=configuration)(cls)
    construct = made.__init__

    @functools.wraps(construct)
    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        try:
            construct(self, *args, **kwargs)
        except ValidationError as error:
            raise ValueError(_sentence(error, [field.name for field in dataclasses.fields(made)])) from None

    made.__init__ = init
    return made


def _sentence(error: ValidationError, fields: list[str]) -> str:
    first = error.errors(include_url=False)[0]
    if first["type"] == "value_error":  # of a check in the class itself, which has a sentence of its own
        return str(first["ctx"]["error"])
    at, *inner = first["loc"]  # a number of what is given without its name
    name = ".".join(map(str, [fields[at] if isinstance(at, int) and at < len(fields) else at, *inner]))
    sentence = f"{name} {first['msg']}".replace(f"{name} Input should", f"{name} must")
    return f"{sentence}, got {first['input']!r}"
