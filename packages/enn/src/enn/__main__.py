"""Lists the trained policies: `python -m enn`; the package has no other command line."""

import os
import sys

from enn.shipped import models

if __name__ == "__main__":
    lines = ["enn has no command lines; enn.load(NAME) loads one of these policies:"]
    lines += [f"{name}: {what}" for name, what in models().items()]
    try:
        print("\n".join(lines), flush=True)
    except BrokenPipeError:  # nobody reads any more, as after `head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains again at its end
    sys.exit(0 if set(sys.argv[1:]) <= {"-h", "--help"} else 2)
