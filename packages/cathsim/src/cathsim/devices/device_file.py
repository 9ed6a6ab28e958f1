"""Devices in YAML files: lengths in mm and angles in degrees with the unit in the key, sizes, sources, inheritance."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
import reprlib
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import yaml

PRESETS = Path(__file__).parent / "presets"
GUIDEWIRE, CATHETER = "guidewire", "catheter"
FOLDERS = {GUIDEWIRE: "guidewires", CATHETER: "catheters"}
LARGEST = 20_000  # bytes of a file; more is no description of a device

# key in a file: field of the settings class
KEYS: dict[str, dict[str, str]] = {
    GUIDEWIRE: {
        "links": "links",
        "diameter_mm": "diameter",
        "shaft_stiffness_nmm2": "shaft_stiffness_nmm2",
        "tip_stiffness_nmm2": "tip_stiffness_nmm2",
        "taper_mm": "taper",
        "tip_angle_deg": "tip_angle",
        "tip_length_mm": "tip_length",
        "density_kg_m3": "density",
        "relaxation_s": "relaxation",
        "friction": "friction",
        "motor_joints": "motor_joints",
        "motor_angle_deg": "motor_angle",
        "torsional_stiffness_nmm2": "torsional_stiffness_nmm2",
        "working_length_mm": "working_length",
    },
    CATHETER: {
        "outer_diameter_mm": "outer_diameter",
        "inner_diameter_mm": "inner_diameter",
        "length_mm": "length",
        "shaft_stiffness_nmm2": "shaft_stiffness_nmm2",
        "tip_stiffness_nmm2": "tip_stiffness_nmm2",
        "taper_mm": "taper",
        "shape": "shape",
        "torsional_stiffness_nmm2": "torsional_stiffness_nmm2",
        "density_kg_m3": "density",
        "friction": "friction",
        "relaxation_s": "relaxation",
        "marker_length_mm": "marker_length",
        "wall_attenuation_per_m": "wall_attenuation",
        "marker_attenuation_per_m": "marker_attenuation",
    },
}
_ABOUT = ("kind", "description", "based_on", "source")
_SIZES, _SIZE = "sizes_french", "default_french"  # of a catheter only
_MOST = {"links": 2000, "shape": 100, "taper_mm": 2}  # entries of a list, as the settings classes have them
# least and most that any device has, in the unit of the key; the settings classes check what is not listed
_STIFFNESS = (0.001, 1e6)
_RANGES: dict[str, tuple[float, float]] = {
    "diameter_mm": (0.1, 5.0),
    "outer_diameter_mm": (0.1, 10.0),
    "inner_diameter_mm": (0.05, 10.0),
    "density_kg_m3": (500.0, 25_000.0),
    "shaft_stiffness_nmm2": _STIFFNESS,
    "tip_stiffness_nmm2": _STIFFNESS,
    "torsional_stiffness_nmm2": _STIFFNESS,
    "tip_angle_deg": (-360.0, 360.0),
    "motor_angle_deg": (0.0, 360.0),
    "angle_deg": (-360.0, 360.0),
    "plane_deg": (-360.0, 360.0),
    **dict.fromkeys(("tip_length_mm", "taper_mm", "length_mm", "working_length_mm", "marker_length_mm"), (0.0, 5000.0)),
}
_STIFFER = 10.0  # than its shaft is the tip of no device
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")  # a number, which YAML 1.1 takes for a text
_BEND = ("from_mm", "to_mm", "angle_deg", "plane_deg")


@dataclasses.dataclass(frozen=True)
class DeviceFile:
    """What a file says of a device, with what it is based on.

    Attributes:
        name: the file's, without folder and ending.
        kind: "guidewire" or "catheter".
        fields: fields of `Guidewire` or `Catheter`, SI, without those that only a size has.
        sizes: fields of each size in French; empty where there are no sizes.
        default_french: size that is meant where none is asked for; None without sizes.
        description: one sentence.
        source: where values come from, by group of values.
    """

    name: str
    kind: str
    fields: dict[str, Any]
    sizes: dict[int, dict[str, Any]]
    default_french: int | None
    description: str
    source: dict[str, str]

    def of_size(self, french: int | None = None) -> dict[str, Any]:
        """Fields of a size; None: the default one.

        Raises:
            ValueError: there is no such size.
        """
        if not self.sizes and french is None:
            return self.fields
        size = self.default_french if french is None else french
        if isinstance(size, bool) or not isinstance(size, int):
            raise ValueError(f"french must be a whole number, got {size!r}")
        if size not in self.sizes:
            sizes = ", ".join(f"{one}F" for one in self.sizes) or "no sizes"
            raise ValueError(f"the {self.kind} '{self.name}' is not made in {size}F: it has {sizes}")
        return self.sizes[size]


def is_file(name: str | Path) -> bool:
    """Whether a device's name means a file: a path, or what ends in .yaml or .yml."""
    return isinstance(name, Path) or str(name).lower().endswith((".yaml", ".yml"))


def preset_path(kind: str, name: str) -> Path:
    """The file of a preset."""
    return PRESETS / FOLDERS[kind] / f"{name}.yaml"


def in_file(path: str | Path, error: ValueError) -> str:
    """A refusal's sentence with the file that it is about in front, once."""
    return str(error) if str(path) in str(error) else f"{path}: {error}"


def read_device(path: str | Path, kind: str) -> DeviceFile:
    """Reads a device's file.

    Args:
        path: of a YAML file; docs/cathsim/devices.md describes its keys.
        kind: "guidewire" or "catheter".

    Raises:
        ValueError: one sentence: the file is missing, no YAML, of another kind, or has an unknown key or a value that
            cannot be converted. Ranges are checked by the settings class.
    """
    path = Path(path)
    content = _content(path, kind)
    allowed = (*_ABOUT, *KEYS[kind], *((_SIZES, _SIZE) if kind == CATHETER else ()))
    _require_known(content, allowed, f"{path}: a {kind}")
    base = _base(path, kind, content.get("based_on"))
    own = _fields(content, kind, path)
    if _SIZES in content:
        rows = _sizes(content[_SIZES], kind, path)
        sizes = {french: {**base.fields, **row, **own} for french, row in rows.items()}
    else:
        sizes = {french: {**fields, **own} for french, fields in base.sizes.items()}
    for fields in ({**base.fields, **own}, *sizes.values()):
        _check_tip(fields, path)
    default = content.get(_SIZE, base.default_french)
    if sizes and (isinstance(default, bool) or not isinstance(default, int) or default not in sizes):
        raise ValueError(
            f"{path}: {_SIZE} must be one of its sizes, {', '.join(map(str, sizes))}, got {_shown(default)}"
        )
    return DeviceFile(
        path.stem,
        kind,
        {**base.fields, **own},
        sizes,
        default if sizes else None,
        _text(content.get("description", base.description), f"{path}: description"),
        {**base.source, **_source(content.get("source", {}), path)},
    )


def _check_tip(fields: Mapping[str, Any], path: Path) -> None:
    """Refuses a tip that is longer than its wire, or far stiffer than its shaft."""
    length, tip = sum(fields.get("links", ())) or math.inf, fields.get("tip_length", 0.0)
    if tip > length:
        raise ValueError(
            f"{path}: tip_length_mm must be at most the length of the links, {1e3 * length:g}, got {1e3 * tip:g}"
        )
    shaft, tip = fields.get("shaft_stiffness_nmm2", math.inf), fields.get("tip_stiffness_nmm2", 0.0)
    if tip > _STIFFER * shaft:
        raise ValueError(
            f"{path}: tip_stiffness_nmm2 must be at most {_STIFFER:g} times shaft_stiffness_nmm2, {shaft:g}, "
            f"got {tip:g}"
        )


@functools.cache
def read_preset(kind: str, name: str) -> DeviceFile:
    """What the file of a preset says: description, sources, fields of each size.

    Args:
        kind: "guidewire" or "catheter".
        name: of the preset, without a size.
    """
    return read_device(preset_path(kind, name), kind)


def file_kind(path: str | Path) -> str:
    """Which kind of device a file describes, "guidewire" or "catheter".

    Raises:
        ValueError: as `read_device` raises it.
    """
    return str(_mapping(Path(path))["kind"])


def _content(path: Path, kind: str) -> dict[str, Any]:
    content = _mapping(path)
    if content["kind"] != kind:
        raise ValueError(f"{path} describes a {content['kind']}, but a {kind} is expected")
    return content


def _mapping(path: Path) -> dict[str, Any]:
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(f"the device's file {path} is no regular file")
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST + 1)
        content = _parsed(text, path) if len(text) <= LARGEST else None
    except FileNotFoundError:
        raise ValueError(f"there is no device's file {path}") from None
    except OSError as error:
        raise ValueError(f"the device's file {path} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        reason = str(getattr(error, "problem", None) or type(error).__name__)
        raise ValueError(f"{path} is no YAML file: {reason}") from None
    except (ValueError, OverflowError) as error:  # of a date or a number that YAML's reader makes
        raise ValueError(f"{path} is no device's file: {' '.join(str(error).split())}") from None
    if len(text) > LARGEST:
        raise ValueError(f"{path} is no device's file: it has more than {LARGEST} bytes")
    if not isinstance(content, dict):
        raise ValueError(f"{path} must hold keys and values, as 'kind: catheter'")
    named_kind = content.get("kind")
    if not isinstance(named_kind, str) or named_kind not in KEYS:
        raise ValueError(f"{path} must say 'kind: guidewire' or 'kind: catheter', got {_shown(named_kind)}")
    return content


def _parsed(text: bytes, path: Path) -> Any:
    """What a file says, read by a safe loader: for the presets libyaml's, fast but crashing on deeply nested lists."""
    fast = getattr(yaml, "CSafeLoader", None)  # not in every build of PyYAML
    loader = (fast if fast is not None and path.parent.parent == PRESETS else yaml.SafeLoader)(text)
    try:
        node = loader.get_single_node()
        _refuse_repeated(node)
        return None if node is None else loader.construct_document(node)
    finally:
        loader.dispose()


def _refuse_repeated(root: yaml.Node | None) -> None:
    """Refuses with a `ValueError` a key that is there twice, of which YAML's readers take the last."""
    waiting, seen = [root] if root else [], set()
    while waiting:
        node = waiting.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            for place, key in enumerate(keys):
                if key in keys[:place]:
                    raise ValueError(f"the key {_shown(key)} is there twice: leave one of them out")
            waiting += [value for _, value in node.value]
        elif isinstance(node, yaml.SequenceNode):
            waiting += node.value


def _base(path: Path, kind: str, name: Any) -> DeviceFile:
    """The preset that a device is based on; an empty one without."""
    if name is None:
        return DeviceFile(path.stem, kind, {}, {}, None, "", {})
    known = sorted(one.stem for one in (PRESETS / FOLDERS[kind]).glob("*.yaml"))
    if name not in known or preset_path(kind, name).resolve() == path.resolve():
        raise ValueError(f"{path}: based_on must be a preset of a {kind}, {', '.join(known)}, got {_shown(name)}")
    return read_preset(kind, name)


def _sizes(values: Any, kind: str, path: Path) -> dict[int, dict[str, Any]]:
    if not isinstance(values, Mapping) or not values:
        raise ValueError(f"{path}: {_SIZES} must have a size in French and its values in each line")
    sizes = {}
    for french, row in values.items():
        if isinstance(french, bool) or not isinstance(french, int) or not 1 <= french <= 34:
            raise ValueError(f"{path}: a size must be a whole number of French, 1 to 34, got {_shown(french)}")
        if not isinstance(row, Mapping):
            raise ValueError(f"{path}: the size {french} must have keys and values, got {_shown(row)}")
        _require_known(row, tuple(KEYS[kind]), f"{path}: a {kind}'s size")
        sizes[french] = _fields(row, kind, path)
    return sizes


def _require_known(values: Mapping[Any, Any], allowed: tuple[str, ...], what: str) -> None:
    for key in values:
        if key not in allowed:
            raise ValueError(f"{what} has no {_shown(key)}; its keys are {', '.join(allowed)}")


def _fields(values: Mapping[str, Any], kind: str, path: Path) -> dict[str, Any]:
    """Fields of the settings class, SI, of what has a key of its own."""
    return {name: _value(key, values[key], path) for key, name in KEYS[kind].items() if key in values}


def _value(key: str, value: Any, path: Path) -> Any:
    if key == "links":
        parts = [_links(part, path) for part in _list(key, value, path)]
        if sum(map(len, parts)) > _MOST[key]:
            raise ValueError(f"{path}: a guidewire has at most {_MOST[key]} links, got {sum(map(len, parts))}")
        return tuple(length for part in parts for length in part)
    if key == "shape":
        return tuple(_bend(part, path) for part in _list(key, value, path))
    if key == "taper_mm":
        return tuple(_quantity(key, part, path) for part in _list(key, value, path))
    return _quantity(key, value, path)


def _links(part: Any, path: Path) -> tuple[float, ...]:
    if not isinstance(part, Mapping) or set(part) != {"count", "length_mm"}:
        raise ValueError(f"{path}: links are given as {{count: 10, length_mm: 16}}, proximal first, got {_shown(part)}")
    count = part["count"]
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= 2000:
        raise ValueError(f"{path}: the count of links must be a whole number from 1 to 2000, got {_shown(count)}")
    return (_quantity("length_mm", part["length_mm"], path),) * count


def _bend(part: Any, path: Path) -> tuple[float, ...]:
    if not isinstance(part, Mapping) or not set(_BEND[:3]) <= set(part) <= set(_BEND):
        raise ValueError(f"{path}: a bend is given as {{from_mm: 0, to_mm: 12, angle_deg: 45}}, got {_shown(part)}")
    return tuple(_quantity(key, part.get(key, 0), path) for key in _BEND)


def _list(key: str, value: Any, path: Path) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f"{path}: {key} must be a list, got {_shown(value)}")
    if len(value) > _MOST[key]:
        raise ValueError(f"{path}: {key} has {len(value)} entries, {_MOST[key]} at most are allowed")
    return value


def _quantity(key: str, value: Any, path: Path) -> float:
    """A number in SI units. Millimetres are converted in decimals, so that 0.89 mm is the number 0.89e-3 m."""
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{path}: {key} must be a number, got {_shown(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{path}: {key} must be a finite number, got {number}")
    least, most = _RANGES.get(key, (-math.inf, math.inf))
    if not least <= number <= most:
        raise ValueError(f"{path}: {key} must be from {least:g} to {most:g}, got {_shown(value)}")
    if key.endswith("_mm"):
        return float(Decimal(repr(value)).scaleb(-3))
    return float(np.radians(number)) if key.endswith("_deg") else number


def _source(values: Any, path: Path) -> dict[str, str]:
    if not isinstance(values, Mapping):
        raise ValueError(f"{path}: source must have a text for each group of values, got {_shown(values)}")
    return {str(group): _text(text, f"{path}: the source of {group}") for group, text in values.items()}


def _shown(value: Any) -> str:
    """The beginning of a value of the file, for a sentence."""
    try:
        return reprlib.repr(value)
    except ValueError:  # of a whole number with thousands of digits
        return "a long number"


def _text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{what} must be a text, got {_shown(value)}")
    return " ".join(value.split())
