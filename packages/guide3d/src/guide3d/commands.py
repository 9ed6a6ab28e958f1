"""Command lines of a package: its modules that run with `python -m`, what they print, and the extras that they need."""

from __future__ import annotations

import ast
import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn


def commands(package: str) -> dict[str, str]:
    """The modules of an installed package that are programs: name to the first line of the module's docstring.

    Modules within a package that is a program itself are its parts and left out. Nothing is imported.
    """
    programs: dict[str, str] = {}
    spec = importlib.util.find_spec(package)
    assert spec, package
    root = Path(str(spec.origin)).parent
    for file in sorted(root.rglob("*.py"), key=lambda file: (len(file.parts), file)):
        module = ".".join((package, *file.relative_to(root).with_suffix("").parts)).removesuffix(".__main__")
        text = file.read_text(encoding="utf-8")
        inside = any(module.startswith(f"{program}.") for program in programs)
        if module != package and not inside and '\nif __name__ == "__main__":' in text:
            programs[module] = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
    return programs


def list_commands(package: str) -> NoReturn:
    """`python -m PACKAGE`: prints a line a command, and ends with exit code 2 for words other than --help."""
    print("\n".join(f"python -m {name}: {what}" for name, what in commands(package).items()))  # noqa: T201
    sys.exit(0 if set(sys.argv[1:]) <= {"-h", "--help"} else 2)


def run(main: Callable[[], int]) -> NoReturn:
    """Ends the program with a command's exit code; what nobody reads any more, as after `head`, is dropped."""
    read_by_nobody()
    try:
        try:
            code: Any = main()
        except SystemExit as end:  # as argparse ends it
            code = end.code
        sys.stdout.flush()
    except OSError as error:  # of standard output
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains again at its end
        code = 0 if isinstance(error, BrokenPipeError) else f"what it prints cannot be written: {error.strerror}"
    except KeyboardInterrupt:
        sys.stderr.write("stopped by Ctrl-C\n")
        code = 130
    sys.exit(code)


def read_by_nobody() -> None:
    """Opens what the program was started without, standard output or errors, so that what is written there is lost.

    A stream that is closed would leave its number to the next file, into which libraries would print.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - for as long as the program runs


def in_words(error: BaseException) -> str:
    """One line about an error, for the end of a command; the system's with the file and without a number."""
    if isinstance(error, BrokenPipeError):
        raise error  # nobody reads what is printed: `run` ends the command
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(text.split())


def require(module: str, extra: str) -> None:
    """Makes sure that an optional dependency is installed, without importing it.

    Raises:
        ModuleNotFoundError: it is not; the message has the command that installs it.
    """
    if importlib.util.find_spec(module) is None:
        raise ModuleNotFoundError(
            f"this part of guide3d needs {module}: pip install 'endonav-guide3d[{extra}]'", name=module
        )


def required_by_command(command: str, module: str, extra: str) -> None:
    """As `require`, for a program of which even the imports need it: ends it with one line and exit code 1."""
    try:
        require(module, extra)
    except ModuleNotFoundError as error:
        sys.exit(f"{command}: {error}")
