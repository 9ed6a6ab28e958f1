"""Command line of the devices: `python -m cathsim.devices` lists the presets and draws them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cathsim.__main__ import run
from cathsim.devices.catheter import Catheter
from cathsim.devices.device_file import CATHETER, file_kind, is_file
from cathsim.devices.shelf import CATHETERS, SHAPES, catheter_file, load_catheter, wire_file
from cathsim.guidewire import GUIDEWIRES, Guidewire, load_guidewire

_MM, _NMM2 = 1e3, 1e6


def main(arguments: Sequence[str] | None = None) -> int:
    """Lists devices as text, and draws them to scale where a file is named; 2 on what cannot be."""
    parser = argparse.ArgumentParser(prog="python -m cathsim.devices", description=main.__doc__)
    parser.add_argument("devices", nargs="*", help="presets or YAML files; all presets where none is given")
    parser.add_argument("--french", type=int, help="size of the catheters; that of their names, or 5, otherwise")
    parser.add_argument("--output", type=Path, help="PNG, PDF or SVG file that the devices are drawn into")
    parser.add_argument("--sources", action="store_true", help="say where the presets' values come from")
    options = parser.parse_args(arguments)
    try:
        devices = {name: load_device(name, options.french) for name in options.devices or (*GUIDEWIRES, *SHAPES)}
        for line in table(devices):
            print(line)
        if options.sources:
            for line in sources(devices):
                print(line)
        if options.output is not None:
            _save(devices, options.output)
    except BrokenPipeError:  # nobody reads what is printed
        raise
    except OSError as error:
        print(f"error: {error.filename or options.output}: {error.strerror}", file=sys.stderr)
        return 2
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def load_device(name: str, french: int | None = None) -> Guidewire | Catheter:
    """The guidewire or catheter of a preset's name or of a YAML file.

    Raises:
        ValueError: there is none.
    """
    if is_file(name):
        return load_catheter(name, french=french) if file_kind(name) == CATHETER else load_guidewire(name)
    if name in GUIDEWIRES:
        return load_guidewire(name)
    if name in CATHETERS:
        return load_catheter(name, french=french)
    raise ValueError(
        f"unknown device '{name}'; there are {', '.join((*GUIDEWIRES, *SHAPES))}, or a path of a .yaml file"
    )


def table(devices: dict[str, Guidewire | Catheter]) -> list[str]:
    """Lines of a table of devices: diameters and length (mm), EI and GJ (N mm^2), bends, friction."""
    lines = [
        f"{'device':<20}{'outer, mm':>10}{'inner, mm':>10}{'hub to tip, mm':>16}{'EI shaft / tip':>16}{'GJ shaft':>10}"
        f"{'friction':>10}  bends, from the tip"
    ]
    for name, device in devices.items():
        if isinstance(device, Guidewire):
            outer, inner, length = device.diameter, "", device.working_length
            bends = (
                f"{np.degrees(device.tip_angle):.0f}° over {device.tip_length * _MM:.0f} mm" if device.tip_angle else ""
            )
        else:
            outer, inner, length = device.outer_diameter, f"{device.inner_diameter * _MM:.2f}", device.length
            bends = ", ".join(
                f"{np.degrees(angle):.0f}° over {start * _MM:.0f}-{end * _MM:.0f} mm"
                for start, end, angle, _ in device.shape
            )
        stiffness = f"{device.shaft_stiffness_nmm2:.0f} / {device.tip_stiffness_nmm2:.0f}"
        lines.append(
            f"{name:<20}{outer * _MM:>10.2f}{inner:>10}{length * _MM:>16.0f}{stiffness:>16}"
            f"{device.torsional_stiffness(length) * _NMM2:>10.0f}{device.friction:>10.2f}  {bends or 'straight'}"
        )
    return lines


def sources(devices: dict[str, Guidewire | Catheter]) -> list[str]:
    """Lines that say where the values of presets come from."""
    lines = []
    for name, device in devices.items():
        if is_file(name):
            continue
        file = wire_file(name) if isinstance(device, Guidewire) else catheter_file(name)
        lines += ["", f"{name}: {file.description}", *(f"  {group}: {text}" for group, text in file.source.items())]
    return lines


def _save(devices: dict[str, Guidewire | Catheter], output: Path) -> None:
    try:
        from cathsim.devices.picture import draw_devices

        figure = draw_devices(devices)
    except ModuleNotFoundError as error:
        raise ValueError(str(error)) from None
    output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(output, bbox_inches="tight")


if __name__ == "__main__":
    run(main)
