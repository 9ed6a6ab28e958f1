"""Command line `python -m pipeline.console`: the simulator's console, its episodes kept as logs of a run."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from cathsim.console.launch import parser, start
from pipeline.config import RunConfig
from pipeline.printing import written
from pipeline.recording.human import McapRecorder, recordings
from pipeline.store.errors import ConfigurationError


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the console until Ctrl-C."""
    syntax = parser(written("console"), folder=None)
    syntax.add_argument("--name", default="desk", metavar="RUN", help="run that the episodes belong to (default desk)")
    syntax.add_argument("--runs-dir", type=Path, default=Path("runs"), help="folder of the runs (default runs)")
    options = syntax.parse_args(arguments)
    try:
        RunConfig(name=options.name)
    except ConfigurationError as error:
        syntax.error(str(error))
    return start(options, McapRecorder, recordings(options.runs_dir, options.name))


if __name__ == "__main__":
    sys.exit(main())
