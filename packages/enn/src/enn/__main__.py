"""Lists the trained policies: `python -m enn`; the package has no other command line."""

import sys

from enn.shipped import models

if __name__ == "__main__":
    print("enn has no command lines; enn.load(NAME) loads one of these policies:")
    print("\n".join(f"{name}: {what}" for name, what in models().items()))
    sys.exit(0 if set(sys.argv[1:]) <= {"-h", "--help"} else 2)
