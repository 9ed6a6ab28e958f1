"""What a report of a problem needs to say about a machine: versions, processor, rendering, GPUs, caches."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path

from cathsim.anatomy.phantom_cache import default_cache_directory
from pipeline.installation import GL_LIBRARIES
from pipeline.jobs.machine import find_gpus
from pipeline.store.errors import StageError
from pipeline.store.provenance import machine

OURS = ("endonav", "endonav-cathsim", "endonav-enn", "endonav-guide3d", "endonav-splineformer")
THEIRS = (
    "mujoco", "gymnasium", "numpy", "scipy", "opencv-python-headless", "torch", "stable-baselines3", "hydra-core",
    "mcap", "trimesh", "pydicom", "nibabel",
)  # fmt: skip
_RENDER = "import mujoco; context = mujoco.GLContext(16, 16); context.make_current(); context.free()"
_SECONDS = 20


def report() -> str:
    """The lines that `endonav info` prints."""
    backend = os.environ.get("MUJOCO_GL")
    rows = [
        *((name, version(name)) for name in (*OURS, *THEIRS)),
        ("python", f"{platform.python_version()}, {sys.executable}"),
        ("system", f"{platform.platform()}, {_libc()}"),
        ("processor", f"{machine()['processor']}, {os.cpu_count()} cores"),
        ("memory", f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 1e9:.0f} GB"),
        ("rendering", _rendering() + (f" (MUJOCO_GL={backend})" if backend else "")),
        ("GPUs", _gpus()),
        ("anatomies in", _size(default_cache_directory())),
        *(("problems to", url) for url in _addresses() if url.endswith("issues")),
    ]
    width = max(len(name) for name, _ in rows) + 2
    return "\n".join(f"{name:<{width}}{what}" for name, what in rows)


def version(distribution: str) -> str:
    """The version of an installed distribution, or that there is none."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _addresses() -> list[str]:
    try:
        urls = importlib.metadata.metadata("endonav").get_all("Project-URL") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return [url.split(", ", 1)[-1] for url in urls]


def _libc() -> str:
    return " ".join(platform.libc_ver()).strip() or "C library unknown"


def _rendering() -> str:
    """Which of MuJoCo's renderers without a screen open a context here; each is tried in a process of its own."""
    probes = {
        backend: subprocess.Popen(
            [sys.executable, "-c", _RENDER], env={**os.environ, "MUJOCO_GL": backend},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        for backend in GL_LIBRARIES
    }  # fmt: skip
    return ", ".join(f"{backend} {'works' if _ends_well(process) else 'fails'}" for backend, process in probes.items())


def _ends_well(process: subprocess.Popen[bytes]) -> bool:
    try:
        return process.wait(_SECONDS) == 0
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False


def _gpus() -> str:
    try:
        gpus = find_gpus()
    except (StageError, subprocess.TimeoutExpired) as error:
        return str(error)
    return ", ".join(f"{gpu.name} with {gpu.total_bytes / 1e9:.0f} GB" for gpu in gpus) or "none that torch finds"


def _size(folder: Path) -> str:
    """A folder and what its files take."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            try:
                total += (Path(place) / name).lstat().st_size
            except OSError:
                continue  # removed by another process in the meantime
    return f"{folder}, {total / 1e9:.2f} GB"
