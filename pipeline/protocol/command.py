"""The command `endonav evaluate`: measures claims, a file of results for each, or a row of the board."""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

from pipeline.printing import Parser, say
from pipeline.protocol.claims import read_protocol
from pipeline.store.errors import ConfigurationError, system_sentence

_FINE, _USAGE = 0, 2


def main(arguments: list[str]) -> int:
    """Runs the command; 2 for wrong usage."""
    parser = Parser(prog="endonav evaluate", description=__doc__)
    parser.add_argument("claims", nargs="*", metavar="CLAIM", help="default: all, which take hours")
    parser.add_argument("--seeds", type=int, default=1, help="how often, each on other anatomies (default 1)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument(
        "--to", type=Path, default=Path("results"), metavar="FOLDER", help="for results (default results)"
    )
    parser.add_argument("--protocol", type=Path, metavar="FILE", help="instead of the project's")
    parser.add_argument("--pages", action="store_true", help="make the documents' tables from the results and leave")
    parser.add_argument("--list", action="store_true", help="print the claims and leave")
    parser.add_argument("--policy", type=Path, metavar="FILE", help="play this policy in the whole of a published task")
    parser.add_argument(
        "--board",
        metavar="TASK",
        help="arch_variety (default), dual_device_nav or random_trees",
    )
    parser.add_argument("--episodes", type=int, metavar="N", help="only the first ones of the task")
    parser.add_argument("--row", type=Path, metavar="FILE", help="for its figures (default row.json)")
    options = parser.parse_args(arguments)
    try:
        if options.policy is not None:
            return _row(options)
        if (options.board, options.episodes, options.row) != (None, None, None):
            raise ConfigurationError("--board, --episodes and --row are of a policy's row: name its file by --policy")
        protocol = read_protocol(options.protocol)
        if unknown := [name for name in options.claims if name not in protocol.claims]:
            raise ConfigurationError(f"there is no claim {unknown[0]!r}: choose from {', '.join(protocol.claims)}")
        if min(options.seeds, options.workers) < 1:
            raise ConfigurationError("--seeds and --workers are 1 at least")
        if options.list:
            say("\n".join(f"{name}: {claim.title}. {claim.limits}" for name, claim in protocol.claims.items()))
            return _FINE
        if options.pages:
            from pipeline.protocol.pages import render

            say("\n".join(map(str, render(options.to))) or "no table changed")
            return _FINE
        os.environ.setdefault("OMP_NUM_THREADS", "1")  # the workers are as many as there are to be
        from pipeline.protocol.run import measure, require_data

        if not options.claims:
            say("measuring all claims, which may take hours: --list shows them, to name some", error=True)
        chosen = options.claims or list(protocol.claims)
        for name in chosen:
            require_data(protocol.claims[name])
        for name in chosen:
            result = measure(name, protocol, options.to, seeds=options.seeds, workers=options.workers, tell=_tell)
            say(_line(name, result["summary"]))
    except (ConfigurationError, OSError, ValueError, BrokenExecutor) as error:
        words = system_sentence(error) if isinstance(error, OSError) else error
        say(f"endonav evaluate: {words}", error=True)
        return _USAGE
    except KeyboardInterrupt:
        note = f"the cases that were played are kept in {options.to}: the same command goes on from there"
        say(f"stopped; {note if options.policy is None else 'no row was written'}", error=True)
        raise
    return _FINE


def _row(options: argparse.Namespace) -> int:
    from pipeline.protocol.board import measure_row, write_row

    if options.claims or (options.episodes is not None and options.episodes < 1):
        raise ConfigurationError("--policy plays in a task: leave claims out, and --episodes is 1 at least")
    row = options.row or Path("row.json")
    if row.is_dir() or not next(place for place in row.absolute().parents if place.exists()).is_dir():
        raise ConfigurationError(f"--row is {'a folder' if row.is_dir() else 'in no folder'}: {row}; name a file")
    say(write_row(measure_row(options.policy, options.board or "arch_variety", options.episodes, _tell), row))
    return _FINE


def _tell(name: str, done: int, count: int) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{name}: {done} of {count} cases" + "\n" * (done == count))
    elif 10 * done // count > 10 * (done - 1) // count:  # a line at each tenth
        say(f"{name}: {done} of {count} cases", error=True)


def _line(name: str, summary: dict[str, Any]) -> str:
    parts = [f"{summary['cases']} cases in {summary['anatomies']} anatomies"]
    parts += [
        f"{key} {value['mean']:g} ({value['low']:g} to {value['high']:g})"
        for key, value in summary.items()
        if isinstance(value, dict)
    ]
    return f"{name}: {', '.join(parts)}"
