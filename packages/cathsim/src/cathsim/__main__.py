"""Lists the package's command lines: `python -m cathsim`."""

import ast
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn


def commands() -> dict[str, str]:
    """The modules that are programs: name to the first line of the docstring; parts of a program are left out."""
    programs: dict[str, str] = {}
    root = Path(__file__).parent
    for file in sorted(root.rglob("*.py"), key=lambda file: (len(file.parts), file)):
        module = ".".join(("cathsim", *file.relative_to(root).with_suffix("").parts)).removesuffix(".__main__")
        text = file.read_text(encoding="utf-8")
        inside = any(module.startswith(f"{program}.") for program in programs)
        if module != "cathsim" and not inside and '\nif __name__ == "__main__":' in text:
            programs[module] = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
    return programs


def list_commands() -> NoReturn:
    """Prints a line a command, and ends with exit code 2 for words other than --help."""
    print("\n".join(f"python -m {name}: {what}" for name, what in commands().items()))
    sys.exit(0 if set(sys.argv[1:]) <= {"-h", "--help"} else 2)


def run(main: Callable[[], int]) -> NoReturn:
    """Ends the program with a command's exit code; what nobody reads any more, as after `head`, is dropped."""
    try:
        try:
            code: Any = main()
        except SystemExit as end:  # as argparse ends it
            code = end.code
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains again at its end
        code = 0
    except KeyboardInterrupt:
        sys.stderr.write("stopped by Ctrl-C\n")
        code = 130
    sys.exit(code)


if __name__ == "__main__":
    run(list_commands)
