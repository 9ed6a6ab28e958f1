"""Settings: dataclasses checked by their annotations, and annotations with the range of each kind of value.

NaN and infinity are refused everywhere. The upper bounds are far above what any training needs; they refuse slips of a
unit or of a zero before hours are spent.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Annotated, Any, dataclass_transform

from annotated_types import Interval
from pydantic import ConfigDict, ValidationError
from pydantic.dataclasses import dataclass

Count = Annotated[int, Interval(ge=1, le=1_000_000_000)]
CountOrNone = Annotated[int, Interval(ge=0, le=1_000_000_000)]  # 0: none, or without a limit
Units = Annotated[int, Interval(ge=1, le=65_536)]  # of a layer
UnitsOrNone = Annotated[int, Interval(ge=0, le=65_536)]
Pixels = Annotated[int, Interval(ge=1, le=8192)]
PixelsOrNone = Annotated[int, Interval(ge=0, le=8192)]
Share = Annotated[float, Interval(ge=0, le=1)]
LearningRate = Annotated[float, Interval(gt=0, le=10)]
Weight = Annotated[float, Interval(ge=0, le=1e6)]  # of a term of a loss
Seconds = Annotated[float, Interval(ge=0, le=1e8)]
Seed = Annotated[int, Interval(ge=0, lt=2**63)]


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def settings(cls: Any) -> Any:
    """Makes a frozen dataclass that raises a ValueError of one sentence for what a field does not take."""
    made: Any = dataclass(frozen=True, config=ConfigDict(allow_inf_nan=False, extra="forbid"))(cls)
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
    if first["type"] == "unexpected_keyword_argument":
        return f"{error.title} has no {first['loc'][0]}"
    at, *inner = first["loc"]  # a number of what is given without its name
    name = ".".join(map(str, [fields[at] if isinstance(at, int) and at < len(fields) else at, *inner]))
    sentence = f"{name} {first['msg']}".replace(f"{name} Input should", f"{name} must")
    return f"{sentence}, got {first['input']!r}"
