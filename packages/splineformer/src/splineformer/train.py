"""Command line of training: python -m splineformer.train DATASET --variant ordered --output FOLDER.

`splineformer.train` is also the function that trains a network; importing this module gives that function.
"""

import sys

if __name__ == "__main__":
    from guide3d.commands import required_by_command, run

    required_by_command("splineformer.train", "torch", "learning")
    from splineformer.learning.training import main

    run(main)
else:
    from splineformer.learning.training import train

    # the import system binds what stands here to the package, where it would hide the function of that name
    sys.modules[__name__] = train  # type: ignore[assignment]
