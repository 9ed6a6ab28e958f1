"""Lists the package's command lines: `python -m guide3d`."""

from functools import partial

from guide3d.commands import list_commands, run

if __name__ == "__main__":
    run(partial(list_commands, "guide3d"))
