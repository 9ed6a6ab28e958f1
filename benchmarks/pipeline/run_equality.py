"""Equality of two runs of the pipeline: every policy, log, table and picture, without times, memory and provenance.

    python benchmarks/pipeline/run_equality.py runs/before runs/after [STAGE ...]
    python benchmarks/pipeline/run_equality.py --quick    # two runs of two stages, made for it

Compared are the bytes of model files and pictures, the steps and images of episode logs, and the values of JSON and CSV
files. Left out are manifests, the page, pictures of training times, and keys that name a time or a speed. Keys of the
last line: equal (files by suffix), differing, missing (in one run alone). The exit code is 1 if anything differs.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader

# Parts of keys and file names that hold a time, a speed or a share of the processor.
_TIME = re.compile(r"(^|_)(cpu|wall|fps|latency|gpu)(_|$)|_s$|_h$|per_s|ms_an?_|training_time|training_speed")
_LEFT_OUT = re.compile(r"manifest\.json|index\.html|sources\.json|.*\.tex|events\.out.*|(.*training.*|errors)\.png")


def values(item: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the values of a JSON document with their keys, without times."""
    if _TIME.search(key.rpartition("/")[2]):
        return
    pairs = item.items() if isinstance(item, dict) else enumerate(item) if isinstance(item, list) else None
    if pairs is None:
        yield key, item
    else:
        for name, part in pairs:
            yield from values(part, f"{key}/{name}")


def rows(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file, without times."""
    if _TIME.search(path.stem):
        return []
    table = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8")))
    return [{name: value for name, value in row.items() if not _TIME.search(name)} for row in table]


def steps_and_images(path: Path) -> Iterator[tuple[str, str]]:
    """Yields topic and digest of the messages of an episode log that hold no time."""
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            data = message.data
            if channel.topic.endswith(("/image", "/mask")):
                image = CompressedImage()
                image.ParseFromString(data)
                data = image.data
            elif channel.topic != "/step":
                continue
            yield channel.topic, hashlib.sha256(data).hexdigest()


def content(path: Path) -> Any:
    """What of a file should be equal, as a value that can be compared."""
    if path.suffix == ".json":
        return sorted(map(repr, values(json.loads(path.read_text(encoding="utf-8")))))
    if path.suffix == ".csv":
        return rows(path)
    if path.suffix == ".mcap":
        return list(steps_and_images(path))
    return hashlib.sha256(path.read_bytes()).hexdigest()


def files(run: Path, stages: list[str]) -> set[str]:
    """Names of a run's files that are compared, below its folder."""
    names = (path.relative_to(run) for path in run.rglob("*") if path.is_file())
    return {
        name.as_posix()
        for name in names
        if not any(part.startswith(".") for part in name.parts)
        and not _LEFT_OUT.fullmatch(name.name)
        and (not stages or name.parts[0] in stages)
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("before", type=Path, nargs="?")
    parser.add_argument("after", type=Path, nargs="?")
    parser.add_argument("stages", nargs="*", help="stages to compare; all by default")
    parser.add_argument("--quick", action="store_true", help="run phantoms and expert twice and compare them")
    arguments = parser.parse_args()
    if arguments.quick:
        with tempfile.TemporaryDirectory() as folder:
            return compare(*(smoke_run(Path(folder), name) for name in ("before", "after")), arguments.stages)
    if arguments.after is None:
        parser.error("give the folders of two runs, or --quick")
    return compare(arguments.before, arguments.after, arguments.stages)


def smoke_run(folder: Path, name: str) -> Path:
    """Runs two stages at the smallest budget and returns the folder of the run."""
    overrides = ["budget=smoke", f"runs_dir={folder}", f"name={name}"]
    subprocess.run([sys.executable, "-m", "pipeline.chain", "phantoms", "expert", "--", *overrides], check=True)
    return folder / name


def compare(run: Path, other: Path, stages: list[str]) -> int:
    """Prints what differs between two runs' folders, in these stages or without any in all; gives the exit code."""
    before, after = files(run, stages), files(other, stages)
    if not before:
        print(f"{run} holds no results: give the folder of a run, e.g. runs/smoke", file=sys.stderr)
        return 2
    equal: Counter[str] = Counter()
    differing = []
    for name in sorted(before & after):
        if content(run / name) == content(other / name):
            equal[Path(name).suffix] += 1
        else:
            differing.append(name)
            print("differs:", name)
    missing = sorted(before ^ after)
    for name in missing:
        print("in one run alone:", name)
    print(json.dumps({"equal": dict(sorted(equal.items())), "differing": len(differing), "missing": len(missing)}))
    return 1 if differing or missing else 0


if __name__ == "__main__":
    sys.exit(main())
