"""Kinds of settings, with the range that a value of each can be meant to have, and the one validator of settings.

A settings dataclass is declared with `validated` in place of `dataclasses.dataclass`; what several fields must agree on
stands in ``__post_init__``. What is refused is one sentence that names the setting. OmegaConf does not see the ranges.
The upper bounds are far above what any run needs; they refuse slips of a unit or of a zero before hours are spent.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable
from dataclasses import field
from typing import Annotated, Any, TypeVar, dataclass_transform

from annotated_types import Ge, Gt, Le, Len
from pydantic import AfterValidator, ConfigDict, TypeAdapter, ValidationError
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
    """Makes a class a dataclass whose constructor refuses a value in a sentence, `prefix` before the field's name."""

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
    """Words the first setting that a validator refused, what it must be, what came; its class is the usual prefix."""
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
    """Refuses what is no set of modalities as the user writes them, e.g. ``I+V+M``."""
    from enn.networks.observation_spaces import modality_keys

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


_LONGEST_NAME = 100  # file systems take 255 bytes, and what is made of a name gets more letters
_DEVICE = re.compile(r"auto|cpu|cuda(:[0-9]{1,3})?")
_FOLDER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")


def folder_name(value: str) -> str:
    """Accepts a name that can become a folder on every system; raises a ValueError otherwise."""
    if len(value) > _LONGEST_NAME:
        raise ValueError(f"has {len(value)} letters: a name that becomes a folder has at most {_LONGEST_NAME}")
    if not _FOLDER_NAME.fullmatch(value):
        raise ValueError(
            f"cannot be {value!r}, for it becomes a folder: use letters, digits, '.', '_', '+' and '-', beginning with "
            "a letter or digit"
        )
    return value


def target_name(value: str) -> str:
    """Accepts a target's name, also with a depth behind the ostium, "rcca@80"; raises a ValueError otherwise."""
    folder_name(re.sub(r"@[0-9]+(\.[0-9]+)?$", "", value))
    return value


def path_text(value: str) -> str:
    """Accepts a text that can be a path; raises a ValueError otherwise."""
    if not value.strip() or "\0" in value:
        raise ValueError("is empty: give a path" if not value.strip() else "holds a zero byte, which no path can")
    return value


def one_of(*choices: str) -> AfterValidator:
    """The check that a text is one of the choices."""

    def check(value: str) -> str:
        if value not in choices:
            raise ValueError(f"has no {shown(value)}: choose from {', '.join(choices)}")
        return value

    return AfterValidator(check)


def _list_check(problem: Callable[[list[Any]], str | None]) -> AfterValidator:
    def check(values: list[Any]) -> list[Any]:
        if message := problem(values):
            raise ValueError(message)
        return values

    return AfterValidator(check)


def _device(value: str) -> str:
    if not _DEVICE.fullmatch(value):
        raise ValueError(f"has no {shown(value)}: choose from auto, cpu, cuda, or one GPU such as cuda:1")
    return value


NOT_EMPTY = _list_check(lambda values: None if values else "is empty: name at least one")
UNIQUE = _list_check(
    lambda values: f"names something twice: {', '.join(map(str, values))}" if len(set(values)) < len(values) else None
)
RISING = _list_check(
    lambda values: f"must rise, got {', '.join(map(str, values))}" if values != sorted(values) else None
)

Device = Annotated[str, AfterValidator(_device)]  # of networks: see `pipeline.jobs.machine`
PathText = Annotated[str, AfterValidator(path_text)]
FolderName = Annotated[str, AfterValidator(folder_name)]
FolderNames = Annotated[list[FolderName], UNIQUE]
TargetName = Annotated[str, AfterValidator(target_name)]
TargetNames = Annotated[list[TargetName], UNIQUE]
SomeFolderNames = Annotated[FolderNames, NOT_EMPTY]

Seed = Annotated[int, Ge(0), Le(1_000_000)]  # those drawn from it stay below 2^32, which NumPy's old generators need
Count = Annotated[int, Ge(1), Le(1_000_000)]
CountOrNone = Annotated[int, Ge(0), Le(1_000_000)]  # 0: none, or the recipe's own number
Episodes = Annotated[int, Ge(1), Le(1_000)]  # a training has 1,000 seeds of its own for episodes
RisingEpisodes = Annotated[list[Episodes], UNIQUE, RISING, NOT_EMPTY]
EpisodesOrNone = Annotated[int, Ge(0), Le(1_000)]
Decisions = Annotated[int, Ge(1), Le(1_000_000_000)]
Trainings = Annotated[int, Ge(1), Le(1_000)]
Accuracy = Annotated[str, one_of("accurate", "fast", "reference")]  # a preset of the simulator
Units = Annotated[int, Ge(1), Le(65_536)]  # of a network's layer
Processes = Annotated[int, Ge(0), Le(1_024)]  # beside each other; 0: one a core
ImageSize = Annotated[int, Ge(36), Le(4_096)]  # px; the learnt encoders' convolutions need 36


def _wire_length(value: float) -> float:
    if value and not 100 <= value <= 2_000:
        raise ValueError(f"must be 0 (as long as the preset) or 100 to 2000 mm, got {value}")
    return value


SuccessRadius = Annotated[float, Gt(0), Le(100)]  # mm
StartJitter = Annotated[float, Ge(0), Le(50)]  # mm
StartRotation = Annotated[float, Ge(0), Le(180)]  # degrees
WireLength = Annotated[float, AfterValidator(_wire_length)]  # mm; 0: the preset's own
NoisePixels = Annotated[float, Ge(0), Le(100)]
Weight = Annotated[float, Ge(0), Le(1e6)]


def _read_as(kind: Any, words: str, made: Callable[[Any], Any] = lambda value: value) -> Any:
    """A setting of a type that OmegaConf does not know, None always among its values, made into what stages take."""
    adapter = TypeAdapter[Any](kind | None, config=ConfigDict(allow_inf_nan=False, strict=True))

    def check(value: Any) -> Any:
        try:
            return None if value is None else made(adapter.validate_python(value))
        except ValidationError as error:
            ours = [str(one["ctx"]["error"]) for one in error.errors() if one["type"] == "value_error"]
            raise ValueError(ours[0] if ours else f"must be {words}, got {shown(value)}") from None

    return Annotated[Any, AfterValidator(check)]


def _with_text_keys(labels: dict[int | str, str | None]) -> dict[str, str | None]:
    return {str(label): vessel for label, vessel in labels.items()}


_SOME = Len(1)
_NAMES = Annotated[dict[FolderName, FolderName], _SOME] | Annotated[list[FolderName], _SOME]
_LABELS = Annotated[dict[int | str, FolderName | None], _SOME]
_PLACE = "a name such as descending or lsa_end, or a point [x,y,z] in mm"

# fields of enn's SacSettings or PpoSettings
Hyperparameters = _read_as(dict[str, Any], "a mapping such as {learning_rate: 3e-4}")
BranchNames = _read_as(_NAMES, "a mapping such as {lcca: lsa} or a list of names")  # of a mesh's branches
# of a label volume
VesselLabels = _read_as(_LABELS, "a mapping such as {3: aorta, 9: lsa} to names or null", _with_text_keys)
EntryPlace = _read_as(FolderName | Annotated[list[float], Len(3, 3)], _PLACE)


@validated()
class JobSettings:
    """How the jobs of a stage are run."""

    workers: Processes = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # jobs beside each other; 0: one a core
    # The networks train on this device: see pipeline.jobs.machine.
    device: Device = field(default="cpu", metadata=NO_EFFECT_ON_RESULTS)
