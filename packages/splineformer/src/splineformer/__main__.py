"""Lists the package's command lines: `python -m splineformer`."""

from functools import partial

from guide3d.commands import list_commands, run

if __name__ == "__main__":
    run(partial(list_commands, "splineformer"))
