"""Command line of reading (`guide3d.reading.command`), and the function `read` (`guide3d.reading.image_reading`).

`guide3d.read` is also the function that reads an image; importing this module gives that function.
"""

import sys

if __name__ == "__main__":
    from guide3d.commands import run
    from guide3d.reading.command import main

    run(main)
else:
    from guide3d.reading.image_reading import read

    # the import system binds what stands here to the package, where it would hide the function of that name
    sys.modules[__name__] = read  # type: ignore[assignment]
