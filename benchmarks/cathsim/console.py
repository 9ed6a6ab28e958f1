"""The console in a headless Chromium: pictures a second and the time from a key to its picture.

Chromium draws without a graphics card here, so a machine with one does better. `--picture FILE` keeps a screenshot.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.cathsim.headless_browser import Tab, find_browser, running_console, wait_until


def drawn(tab: Tab) -> np.ndarray:
    """Pictures received and drawn so far, and the page's time in seconds. Shape (3,)."""
    numbers = tab.value("[consoleStatistics.received, consoleStatistics.drawn, performance.now() / 1000]")
    return np.array(numbers, float)


def measure(tab: Tab, seconds: float, taps: int) -> dict[str, float]:
    """Holds a key for the rate of pictures, then taps keys at irregular times for the latency.

    Args:
        tab: with a console that waits to be touched.
        seconds: how long the key is held.
        taps: keys pressed and released.

    Returns:
        The figures.
    """
    generator = np.random.default_rng(0)
    tab.key("ArrowUp", down=True)
    before = drawn(tab)
    time.sleep(seconds)
    received, shown, elapsed = drawn(tab) - before
    tab.key("ArrowUp", down=False)
    for number in range(taps):
        name = "ArrowDown" if number % 2 else "ArrowUp"
        for down in (True, False):
            tab.key(name, down=down)
            time.sleep(generator.uniform(0.12, 0.3))
    latencies = np.array(tab.value("consoleStatistics.latencies"))
    return {
        "received_fps": received / elapsed,
        "drawn_fps": shown / elapsed,
        "latency_median_ms": float(np.median(latencies)),
        "latency_p90_ms": float(np.percentile(latencies, 90)),
        "latency_max_ms": float(latencies.max()),
        "load": os.getloadavg()[0],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="less than 50 s")
    parser.add_argument("--catheter", default="none", help="that the wire lies in (default %(default)s)")
    parser.add_argument("--picture", type=Path, help="PNG of the console, an episode going on")
    options = parser.parse_args()
    if find_browser() is None:
        print("no Chromium is installed (Debian: apt install chromium): nothing measured")
        print(json.dumps({"benchmark": "console", "skipped": "no Chromium"}))
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        running_console(
            "--record", f"{folder}/episodes", "--max-steps", "1000", "--catheter", options.catheter
        ) as address,
        Tab(Path(folder) / "profile") as tab,
    ):
        tab.open(address)
        figures = measure(tab, seconds=6.0 if options.quick else 20.0, taps=25 if options.quick else 100)
        if options.picture:
            if options.catheter != "none":
                tab.key("w", down=True)
                wait_until(lambda: tab.frame()["catheter_insertion_mm"] > 110, 40)
                tab.key("w", down=False)
            tab.key("ArrowUp", down=True)
            wait_until(lambda: tab.frame()["insertion_mm"] > 150, 40)
            tab.key("c", down=True)
            tab.key("c", down=False)
            wait_until(lambda: tab.frame()["contrast"] > 0.5, 10)
            tab.screenshot(options.picture)
            tab.key("ArrowUp", down=False)
    for name, value in figures.items():
        print(f"{name:20} {value:8.1f}")
    rounded = {name: round(value, 2) for name, value in figures.items()}
    print(json.dumps({"benchmark": "console", "catheter": options.catheter, **rounded}))


if __name__ == "__main__":
    main()
