"""Time to import the simulator and to make an environment whose phantom is cached.

    python benchmarks/cathsim/startup.py [--quick]

Every figure is the median over fresh interpreters. Prints a table and, as its last line, one JSON object:
    import_s        `import cathsim`
    make_s          the first `gymnasium.make("cathsim/Navigate-v0", observation=("image", "mask"))` and reset after it
    import_all_s    importing gymnasium and everything that the environment needs
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys

PROGRAM = """
import time
start = time.perf_counter(); import cathsim; imported = time.perf_counter()
import gymnasium
env = gymnasium.make("cathsim/Navigate-v0", observation=("image", "mask")); env.reset(seed=0)
print(imported - start, time.perf_counter() - imported)
"""
IMPORTS = """
import time
start = time.perf_counter(); import cathsim.environment
print(time.perf_counter() - start)
"""


def run(program: str) -> list[float]:
    """Numbers that a program prints in a fresh interpreter."""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="three interpreters instead of nine")
    count = 3 if parser.parse_args().quick else 9
    run(PROGRAM)  # fills the phantom's cache
    first = [run(PROGRAM) for _ in range(count)]
    result = {
        "import_s": statistics.median(row[0] for row in first),
        "make_s": statistics.median(row[1] for row in first),
        "import_all_s": statistics.median(run(IMPORTS)[0] for _ in range(count)),
    }
    for name, value in result.items():
        print(f"{name:14s}{value:8.3f} s")
    print(json.dumps({name: round(value, 4) for name, value in result.items()}))


if __name__ == "__main__":
    main()
