"""The command line of episode logs: `python -m pipeline.episodes info|check|recover|film FILE`, `export FOLDER`.

Exit codes: 0 all is well, 1 a log is damaged, 2 wrong usage, a file that is not there or cannot be written.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pipeline.episodes.checking import check
from pipeline.episodes.encoding.schema import DEVICE_MASKS
from pipeline.episodes.reader import EpisodeReader
from pipeline.episodes.records import EpisodeReadError
from pipeline.episodes.recovery import recover
from pipeline.printing import Parser, say, visible, written
from pipeline.store.errors import PipelineError, StageError

FINE, DAMAGED, USAGE, INTERRUPTED = 0, 1, 2, 130


def _say(message: object, *, error: bool = False) -> None:
    say(visible(str(message)), error=error)


def _show_info(path: Path) -> int:
    with EpisodeReader(path) as log:
        info, outcome = log.info, log.outcome
        started = datetime.fromtimestamp(info.start_time_ns / 1e9, tz=UTC).isoformat(timespec="milliseconds")
        success = {True: "success", False: "no success", None: "success unknown"}[outcome.success]
        mesh = log.phantom_mesh()
        rows = [
            ("phantom", f"{info.phantom} ({info.phantom_hash})"),
            ("task", f"{info.entry} -> {info.target}, seed {info.seed}, steered by {info.operator}"),
            *([("catheter", f"{info.catheter_name}, torsion {info.configuration.get('torsion')}")] * info.has_catheter),
            ("started", started),
            ("outcome", f"{outcome.status}, {success}, {outcome.steps} steps of {info.control_dt:g} s"),
            ("records", f"{len(log)}, {path.stat().st_size / max(len(log), 1):.0f} bytes each"),
            *((f"metric {name}", str(value)) for name, value in sorted(outcome.metrics.items())),
        ]
        for name in log.cameras:
            camera = log.camera(name)
            streams = [stream for stream in ("image", "mask", *DEVICE_MASKS) if log.has(name, stream)]
            rows.append(
                (f"camera {name}", f"{camera.width} x {camera.height} px, {' + '.join(streams) or 'no pictures'}")
            )
        if mesh is not None:
            rows.append(("mesh", f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces"))
        if outcome.missing_steps:
            rows.append(("lost steps", ", ".join(map(str, outcome.missing_steps))))
        rows += [(f"version {name}", value) for name, value in sorted(info.versions.items())]
        rows.append(("configuration", json.dumps(info.configuration, sort_keys=True)))
    width = max(len(key) for key, _ in rows)
    _say(path)
    for key, value in rows:
        _say(f"  {key:<{width}}  {value}")
    return FINE


def _show_check(path: Path) -> int:
    report = check(path)
    for problem in report.problems:
        _say(problem if str(path) in problem else f"{path} is damaged: {problem}", error=True)
    if report.problems:
        return DAMAGED
    notes = f" ({'; '.join(report.notes)})" if report.notes else ""
    _say(f"{path} is fine: {report.records} records, {report.pictures} pictures{notes}")
    return FINE


def _default_destination(source: Path) -> Path:
    if source.suffix == ".partial":
        return source.with_suffix("")
    return source.with_name(f"{source.stem}.recovered{source.suffix}")


def _run_recover(source: Path, destination: Path | None, overwrite: bool) -> int:
    report = recover(source, destination or _default_destination(source), overwrite=overwrite)
    outcome = "the outcome is kept" if report.outcome_kept else "the outcome is lost: marked as interrupted"
    missing = f", {len(report.missing_steps)} known to be missing" if report.missing_steps else ""
    _say(
        f"{report.destination}: {report.steps_kept} records kept{missing}; "
        f"{report.bytes_dropped} damaged bytes dropped; {outcome}"
    )
    return FINE


def _run_film(source: Path, destination: Path | None) -> int:
    from pipeline.recording.replay import film_of

    _say(film_of(source, destination or source.with_suffix(".gif")))
    return FINE


def _run_export(arguments: argparse.Namespace, folder: Path) -> int:
    from pipeline.episodes.export.exporting import export_logs

    try:
        report = export_logs(
            folder,
            arguments.to,
            arguments.output,
            name=arguments.name,
            pictures=not arguments.no_pictures,
            masks=arguments.masks,
            overwrite=arguments.overwrite,
        )
    except KeyboardInterrupt:
        _say(f"interrupted: nothing was left at {arguments.output}", error=True)
        return INTERRUPTED
    plural = "s" * (report.episodes != 1)
    _say(f"{report.destination}: {report.episodes} episode{plural}, {report.steps} steps; open it with {report.hint}")
    return FINE


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog=written("episodes"),
        description="Look at episode logs, check them, recover damaged ones, film and export them.",
        epilog="Exit codes: 0 all is well; 1 a log is damaged; 2 wrong usage, missing file, unwritable destination.",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="info|check|recover|film|export")

    def command(name: str, text: str, *, argument: str = "FILE", about: str = "a log", nargs: Any = 1) -> Any:
        made = commands.add_parser(name, help=text, description=f"{text[:1].upper()}{text[1:]}.")
        made.add_argument("paths", type=Path, nargs=nargs, metavar=argument, help=about)
        return made

    command("info", "show what a log holds", nargs="+")
    command("check", "verify every checksum, step and picture", nargs="+")
    recovering = command(
        "recover",
        "save what is intact of a damaged or unfinished log; the file itself is left as it is",
        about="the damaged log, or the .partial of a killed writer",
    )
    text = "the valid log (default: FILE without .partial, or with .recovered before its ending)"
    recovering.add_argument("out", nargs="?", type=Path, metavar="OUT", help=text)
    recovering.add_argument("--overwrite", action="store_true", help="replace OUT if it exists")
    filming = command("film", "repeat a logged episode in the simulator and film fluoroscopy and 3-D view")
    filming.add_argument("out", nargs="?", type=Path, metavar="OUT", help="the GIF (default: FILE with that ending)")
    exporting = command(
        "export",
        "write all logs in a folder and below it as one data set for other software; OUTPUT appears when it is whole",
        argument="FOLDER",
        about="with logs, e.g. runs/NAME/expert",
    )
    exporting.add_argument("--to", required=True, choices=("lerobot", "minari", "hdf5"), help="format")
    exporting.add_argument("--output", required=True, type=Path, metavar="OUTPUT", help="folder of the data set")
    exporting.add_argument("--name", help="of the data set (default: that of OUTPUT)")
    exporting.add_argument("--no-pictures", action="store_true", help="numbers alone")
    exporting.add_argument("--masks", action="store_true", help="also the masks of the devices")
    exporting.add_argument("--overwrite", action="store_true", help="replace OUTPUT if it exists")
    return parser


def _run(arguments: argparse.Namespace, path: Path) -> int:
    try:
        if arguments.command == "export":
            return _run_export(arguments, path)
        if not path.is_file():
            _say(f"{path} is no file: give the path of an episode log", error=True)
            return USAGE
        if not os.access(path, os.R_OK):
            _say(f"{path} may not be read: check its permissions", error=True)
            return USAGE
        if arguments.command == "info":
            return _show_info(path)
        if arguments.command == "check":
            return _show_check(path)
        if arguments.command == "film":
            return _run_film(path, arguments.out)
        return _run_recover(path, arguments.out, arguments.overwrite)
    except (EpisodeReadError, StageError) as error:  # the latter of an episode that does not repeat
        _say(error, error=True)
        return DAMAGED
    except PipelineError as error:
        _say(error, error=True)
        return USAGE
    except OSError as error:
        _say(f"cannot read {path}: {error.strerror or error}; check its permissions", error=True)
        return USAGE


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; give the exit code: 0 fine, 1 damaged, 2 usage."""
    arguments = _parser().parse_args(argv)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a path or a log's text may hold what the terminal cannot
    return max(_run(arguments, path) for path in arguments.paths)


if __name__ == "__main__":
    sys.exit(main())
