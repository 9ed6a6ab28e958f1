"""The shelf: catheter presets in their sizes, one's own catheters, and what a device's file says of it."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from cathsim.devices.catheter import Catheter
from cathsim.devices.device_file import (
    CATHETER,
    GUIDEWIRE,
    DeviceFile,
    in_file,
    is_file,
    preset_path,
    read_device,
    read_preset,
)

# files in cathsim/devices/presets/catheters; the names are those of their unloaded shapes
SHAPES = ("straight", "vertebral", "simmons1", "simmons2", "headhunter", "jb2", "pigtail")
_SIZED = re.compile(r"(.+)_(\d+)f")


def load_catheter(name: str | Path, *, french: int | None = None, **changes: object) -> Catheter:
    """A preset catheter, or one's own from a YAML file, with fields of `Catheter` replaced.

    Args:
        name: of a preset, with its size or without ("simmons2", "simmons2_6f"), or a path that ends in .yaml or .yml.
        french: size; None: that of the name, or else the file's default (5F for the presets).

    Raises:
        ValueError: unknown preset, size or field; a file that is missing or does not describe a catheter; a shape that
            no tube has.
    """
    if is_file(name):
        path = Path(name)
        file = read_device(path, CATHETER)
    else:
        shape, size = _shape_and_size(str(name))
        if french is not None and size is not None and french != size:
            raise ValueError(f"the catheter '{name}' is of {size}F, but french={french} is asked for")
        french = size if french is None else french
        path, file = preset_path(CATHETER, shape), read_preset(CATHETER, shape)
    values = file.of_size(french)
    try:
        catheter = Catheter(**values)
    except ValueError as error:
        raise ValueError(in_file(path, error)) from None
    return dataclasses.replace(catheter, **changes) if changes else catheter  # type: ignore[arg-type]


def wire_file(name: str) -> DeviceFile:
    """What the file of a preset guidewire says."""
    return read_preset(GUIDEWIRE, name)


def catheter_file(name: str) -> DeviceFile:
    """What the file of a preset catheter says; its name may have a size."""
    return read_preset(CATHETER, _shape_and_size(name)[0])


def catheter_preset_of(catheter: Catheter) -> str | None:
    """The preset that a catheter is, with its size unless that is the default one; None: of no preset."""
    return next((name for name, preset in CATHETERS.items() if preset == catheter), None)


def catheter_shape(name: str) -> str:
    """The shape of a preset's name, without its size; the path of a YAML file as it is.

    Raises:
        ValueError: unknown preset.
    """
    return name if is_file(name) else _shape_and_size(name)[0]


def _shape_and_size(name: str) -> tuple[str, int | None]:
    sized = _SIZED.fullmatch(name)
    shape, size = (sized[1], int(sized[2])) if sized else (name, None)
    if shape not in SHAPES:
        raise ValueError(
            f"unknown catheter '{name}'; there are {', '.join(SHAPES)}, with a size as in '{SHAPES[0]}_6f', or a path "
            "of a .yaml file"
        )
    return shape, size


def _presets() -> dict[str, Catheter]:
    """Every shape in its default size, then every shape in every size."""
    files = {shape: read_preset(CATHETER, shape) for shape in SHAPES}
    sized = {
        f"{shape}_{french}f": load_catheter(shape, french=french) for shape in SHAPES for french in files[shape].sizes
    }
    return {shape: sized[f"{shape}_{file.default_french}f"] for shape, file in files.items()} | sized


CATHETERS: dict[str, Catheter] = _presets()
