"""What an installation needs, checked before pip runs: Python, a compiler, a GL library.

Runs with the standard library alone, before anything is installed: ``python pipeline/installation.py before``.
"""

from __future__ import annotations

import argparse
import ctypes
import ctypes.util
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

OLDEST_PYTHON = (3, 11)
# Renderers of MuJoCo without a screen, in the order of preference: MUJOCO_GL's value and the shared library behind it.
GL_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
DEBIAN_GL_PACKAGES = ("libegl1", "libgl1-mesa-dri", "libosmesa6")
NEEDED_GB = 4.0  # on the disk of a new environment: its smallest form, and one package on its way there


def missing_for_build(environment: str = ".venv") -> list[str]:
    """Lists what keeps the packages from being built and installed: a sentence a thing, saying how to get it."""
    missing = []
    if sys.version_info < OLDEST_PYTHON:
        minimum, have = ".".join(map(str, OLDEST_PYTHON)), ".".join(map(str, sys.version_info[:3]))
        missing.append(
            f"Python {minimum} or newer is needed, this is {have}: install one and run `make PYTHON=/path/to/python`"
        )
    if importlib.util.find_spec("venv") is None or importlib.util.find_spec("ensurepip") is None:
        version = f"{sys.version_info[0]}.{sys.version_info[1]}"
        missing.append(f"Python's venv module is missing: on Debian `apt-get install python{version}-venv`")
    place = Path(environment).absolute()
    free = shutil.disk_usage(next(folder for folder in place.parents if folder.is_dir())).free / 1e9
    if free < NEEDED_GB and not place.exists():
        missing.append(
            f"{free:.1f} GB are free on this disk and {NEEDED_GB:.0f} are needed, 8 with torch for CUDA: make room, or "
            "run `make setup VENV=/folder/on/another/disk`"
        )
    if not (os.environ.get("CC") or any(shutil.which(name) for name in ("cc", "gcc", "clang"))):
        missing.append("no C compiler found: on Debian `apt-get install build-essential`, or set CC")
    return missing


def gl_backend() -> str | None:
    """Finds a library that MuJoCo can render with when there is no screen: the value for ``MUJOCO_GL``, or None."""
    for backend, library in GL_LIBRARIES.items():
        name = ctypes.util.find_library(library)
        if name is None:
            continue
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return backend
    return None


def install_gl() -> None:
    """Tries to install a GL library, which works as root on Debian and its relatives; elsewhere it does nothing."""
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        return
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for command in (
        ["apt-get", "update", "-q"],
        ["apt-get", "install", "-qy", "--no-install-recommends", *DEBIAN_GL_PACKAGES],
    ):
        subprocess.run(command, check=False, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def main(arguments: list[str]) -> int:
    """Runs the command line: ``before`` an installation, or ``gl``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("when", choices=["before", "gl"], help="the installation; gl prints the renderer to use")
    parser.add_argument("--environment", default=".venv", help="folder of the environment to install into")
    options = parser.parse_args(arguments)
    if options.when == "gl":
        print(gl_backend() or "disabled")
        return 0
    problems = missing_for_build(options.environment)
    if gl_backend() is None:
        install_gl()
    if gl_backend() is None:
        # Only rendering for people needs it: fluoroscopy, learning and tests of physics run without.
        print("note: no GL library for rendering (libEGL or libOSMesa): on Debian "
              f"`apt-get install {' '.join(DEBIAN_GL_PACKAGES)}`; the 3-D films are left out until then",
              file=sys.stderr)  # fmt: skip
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
