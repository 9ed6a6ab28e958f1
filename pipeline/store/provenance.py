"""Provenance: which code, versions and machine a result came from, and hashes that tell whether it is current."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

from pipeline.store.atomic_files import open_file

PROJECT_ROOT = Path(__file__).resolve().parents[2]
_CODE = (".", ":(exclude)results", ":(exclude)docs", ":(exclude)*.md")  # what no result depends on is left out
_REPORTED_DISTRIBUTIONS = ("numpy", "scipy", "mujoco", "gymnasium", "dm_control", "scikit-image", "trimesh", "torch",
                           "stable-baselines3", "mcap", "hydra-core")  # fmt: skip


def project_file(path: str) -> Path:
    """A file of the project that its installed package has, too."""
    tree = PROJECT_ROOT / path
    return tree if tree.is_file() else Path(__file__).resolve().parents[1] / path


def hash_value(value: Any) -> str:
    """Hashes any JSON-like value, independent of the order of its keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def hash_file(path: Path) -> str:
    """SHA-256 of a file's content, in hex."""
    with open_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def hash_anatomy(path: Path) -> str:
    """SHA-256, hex, of a file and the data beside a volume's header, or of names and contents of a folder's files."""
    files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else _whole(path)
    if files == [path]:
        return hash_file(path)
    digest = hashlib.sha256()
    for one in files:
        digest.update(os.fsencode(one.name) + f"\0{hash_file(one)}\0".encode())
    return digest.hexdigest()


def _whole(path: Path) -> list[Path]:
    from cathsim.anatomy.mesh.parts.vessel_parts import surface_files
    from cathsim.anatomy.mesh.reading import SCENES
    from cathsim.anatomy.volume.files.detached import with_detached_data

    if path.suffix.lower() in SCENES:
        with contextlib.suppress(ValueError):  # what its reader says, too
            return surface_files(path)
    return with_detached_data([path])


@functools.cache
def present_commit() -> str:
    """Names the commit of the code: hex, with "+" where files differ from it; "unknown" outside a repository."""
    commit, changed = _git("rev-parse", "--short=12", "HEAD"), _git("status", "--porcelain", "--", *_CODE)
    return "unknown" if commit is None or changed is None else f"{commit}+" if changed else commit


@functools.cache
def uncommitted_changes() -> str:
    """A hash of what differs from the commit in files that it has; "" where nothing does, or where there is none."""
    changes = _git("diff", "HEAD", "--", *_CODE)
    return hash_value(changes) if changes else ""


def _git(*arguments: str) -> str | None:
    if not (PROJECT_ROOT / ".git").exists():  # installed: a repository around it is somebody else's
        return None
    try:
        done = subprocess.run(
            ["git", "-C", str(PROJECT_ROOT), *arguments], capture_output=True, text=True, errors="replace", timeout=60,
            check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


@functools.cache  # reading them takes as long as some twenty steps of the simulator
def software_versions() -> dict[str, str]:
    """Lists the versions of Python and of the installed distributions that results depend on."""
    versions = {"python": platform.python_version()}
    for name in _REPORTED_DISTRIBUTIONS:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


@functools.cache
def machine() -> dict[str, str]:
    """Describes the computer that a speed or a training time was measured on, as text for the report."""
    return {
        "operating_system": _operating_system(),
        "processor": _first_value(Path("/proc/cpuinfo"), "model name") or platform.processor() or platform.machine(),
        "cores": str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()),
        "memory_gb": f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f}",
        "gpu": _gpu() or "none",
    }


def _operating_system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.platform(terse=True)


def _first_value(path: Path, key: str) -> str | None:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(key) and ":" in line), None)


def _gpu() -> str | None:
    try:
        done = subprocess.run(
            ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"],
            capture_output=True, text=True, timeout=10, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip().replace("\n", ", ") or None if done.returncode == 0 else None
