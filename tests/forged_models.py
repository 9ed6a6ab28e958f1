"""Forged models: files with a right digest that ask for more than they hold, or hold what no network has."""

import copy
import hashlib
import io
import os
import re
import resource
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch

SECONDS, MEGABYTES = 10.0, 600
HUGE = (10**6, 10**12)


def saved(content: Any) -> bytes:
    """What torch writes of content."""
    stream = io.BytesIO()
    torch.save(content, stream)
    return stream.getvalue()


def sealed(body: bytes) -> bytes:
    """A model's file around what torch wrote."""
    return b"sha256 " + hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def repacked(body: bytes, change: Callable[[bytes], bytes] = bytes, method: int = zipfile.ZIP_STORED) -> bytes:
    """The archive again, its pickle changed or its parts compressed."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(body)) as archive, zipfile.ZipFile(stream, "w", method) as out:
        for name in archive.namelist():
            data = archive.read(name)
            out.writestr(name, change(data) if name.endswith("data.pkl") else data)
    return stream.getvalue()


def contents() -> dict[str, Any]:
    """Things that no network has."""
    recursive: list[Any] = []
    recursive.append(recursive)
    doubled: Any = [1]
    for _ in range(60):
        doubled = [doubled, doubled]
    deep: Any = 1
    for _ in range(200):
        deep = [deep]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        quantised, rows = torch.quantize_per_tensor(torch.zeros(3), 1.0, 0, torch.quint8), torch.eye(3).to_sparse_csr()
    return {
        "sparse": torch.eye(3).to_sparse(),
        "compressed rows": rows,
        "quantised": quantised,
        "meta": torch.empty(10**6, 10**6, device="meta"),
        "expanded": torch.zeros(1).expand(10**6, 10**6),
        "recursive": recursive,
        "doubled": doubled,
        "deep": deep,
        "bytes": b"abc",
        "set": {1},
    }


def forged_files(content: dict[str, Any]) -> Iterator[tuple[str, bytes]]:
    """Files of a model with other things in it: what is forged, and the bytes."""
    for name, thing in contents().items():
        for place in {"metadata", "weights"} & content.keys():
            yield f"{name} in {place}", sealed(saved({**content, place: {**content[place], "x": thing}}))
    marked = saved({**content, "x": torch.zeros(251, 3)})
    size = b"K\xfbK\x03\x86"  # of that tensor, as a pickle has it
    yield "tensor of 40 GB", sealed(repacked(marked, lambda data: data.replace(size, b"J\xff\xff\xff\x7fK\x05\x86")))
    yield "compressed", sealed(repacked(saved({**content, "x": torch.zeros(10**7)}), method=zipfile.ZIP_DEFLATED))
    yield "no archive", sealed(b"nothing")


def inflated(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Content in which one number after the other is far too large, and one tuple far too long."""
    if isinstance(value, bool) or value is None:
        return
    if isinstance(value, int):
        yield from ((f"{place}={size}", size) for size in HUGE)
    elif isinstance(value, dict):
        for name, part in value.items():
            if name not in ("weights", "metadata", "perception"):
                for changed, new in inflated(part, f"{place}/{name}"):
                    yield changed, {**value, name: new}
    elif isinstance(value, list | tuple) and len(value) < 10:
        for number, part in enumerate(value):
            for changed, new in inflated(part, f"{place}/{number}"):
                yield changed, type(value)([*value[:number], new, *value[number + 1 :]])
        if value and all(type(one) is int for one in value):
            yield f"{place} long", type(value)(list(value) * 300)


def refusal(load: Callable[[], Any]) -> str:
    """The sentence with which something is refused; empty where it is loaded."""
    try:
        load()
    except (FileNotFoundError, ValueError) as error:
        return str(error)
    return ""


def require_refusals(path: Path, load: Callable[[], Any], *, forged: bool) -> int:
    """Loads variants of a model's file with other sizes: refused in one sentence, at once, in little memory.

    Sizes that change nothing that is built may load.

    Args:
        forged: also files with what no network has, which a package reads alike for all its models.

    Returns:
        How many were refused.
    """
    whole = path.read_bytes()
    content = torch.load(io.BytesIO(whole[whole.index(b"\n") + 1 :]), weights_only=True)
    load()  # what is imported first takes time
    before, refused = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, 0
    files = [(name, sealed(saved(copy.deepcopy(new))), False) for name, new in inflated(content)]
    files += [(name, data, True) for name, data in forged_files(content)] if forged else []
    for name, data, never in files:
        path.write_bytes(data)
        began = time.process_time()
        said = refusal(load)
        refused += bool(said)
        assert said or not never, f"{name} was loaded"
        assert "\n" not in said, name
        assert len(said) < 600 + len(str(path)), name
        assert time.process_time() - began < SECONDS, name
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEGABYTES * 1024, name
    path.unlink()
    os.mkfifo(path)
    assert refusal(load), "a pipe was loaded"
    path.unlink()
    with path.open("wb") as file:
        file.truncate(5 << 30)  # sparse
    assert re.search(r"more than 4 GB|at most 4\.29 GB are read", refusal(load))
    path.write_bytes(whole)
    assert not refusal(load)
    return refused
