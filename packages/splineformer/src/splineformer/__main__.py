"""Lists the package's command lines: `python -m splineformer`."""

import sys

from guide3d.commands import listing, say

if __name__ == "__main__":
    text, code = listing("splineformer", sys.argv[1:])
    say(text)
    sys.exit(code)
