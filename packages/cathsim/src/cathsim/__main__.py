"""Lists the package's command lines: `python -m cathsim`."""

import ast
import os
import sys
from pathlib import Path


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


if __name__ == "__main__":
    try:
        print("\n".join(f"python -m {name}: {what}" for name, what in commands().items()), flush=True)
    except BrokenPipeError:  # nobody reads any more, as after `head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains again at its end
    sys.exit(0 if set(sys.argv[1:]) <= {"-h", "--help"} else 2)
