"""Distributions install alone: into an empty environment, then used from there, not from this tree."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy
import pytest

from pipeline.config import BUDGETS
from pipeline.installation import CUDA_DISTRIBUTIONS
from pipeline.stages import available_stages
from pipeline.store.manifest import read_manifest

PROJECT_ROOT = Path(__file__).resolve().parents[2]

USE_CATHSIM = """
import gymnasium, numpy as np, cathsim
from cathsim.anatomy import load_phantom
phantom = load_phantom("type_1", resolution=2e-3)
assert phantom.grid.sample(phantom.targets["bca"].position[None])[0] > 0
environment = gymnasium.make("cathsim/Navigate-v0", phantom="type_1", target="bca")
environment.reset(seed=0)
for _ in range(3):
    _, reward, terminated, truncated, _ = environment.step(np.ones(environment.action_space.shape, np.float32))
assert np.isfinite(reward) and not truncated
print(cathsim.__version__)
"""


def make_environment(folder: Path) -> Path:
    """Makes an empty virtual environment.

    Args:
        folder: where.

    Returns:
        Its Python.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, capture_output=True, timeout=60)
    return folder / "bin" / "python"


def install_and_use(package: str, snippet: str, folder: Path) -> str:
    """Installs one distribution with pinned dependencies and runs a snippet outside this tree.

    Args:
        package: its folder below packages/.
        snippet: Python code that uses it.
        folder: a temporary folder.

    Returns:
        What the snippet printed.
    """
    python = make_environment(folder / "environment")
    # A copy: building leaves files beside the sources, and stale ones there would end up in later builds.
    source = folder / package
    shutil.copytree(
        PROJECT_ROOT / "packages" / package, source, ignore=shutil.ignore_patterns("build", "*.so", "*.egg-info")
    )
    constraints = PROJECT_ROOT / "constraints.txt"
    # This environment's pip works on the empty one: giving that a pip of its own would only cost time.
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--disable-pip-version-check"]
    done = subprocess.run(
        [*pip, "install", "-qq", "--no-compile", "-c", str(constraints), str(source)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["CATHSIM_CACHE"] = str(folder / "cache")
    used = subprocess.run(
        [str(python), "-c", snippet],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert used.returncode == 0, used.stderr[-2000:]
    listed = subprocess.run([*pip, "list", "--format=freeze"], capture_output=True, text=True, timeout=60, check=True)
    installed = {line.split("==")[0].lower() for line in listed.stdout.splitlines()}
    assert {name for name in installed if name.startswith("endonav")} == {f"endonav-{package}"}
    assert not installed & {"torch", "torchvision", "hydra-core", "stable-baselines3"}
    return used.stdout.strip()


@pytest.mark.slow
def test_cathsim_installs_alone_with_its_native_code(tmp_path: Path) -> None:
    assert install_and_use("cathsim", USE_CATHSIM, tmp_path).startswith("0.")


DISTRIBUTIONS = ("cathsim", "enn", "guide3d", "splineformer")


def installing(package: str) -> list[str]:
    """The folders that the command of a package's readme installs."""
    text = (PROJECT_ROOT / "packages" / package / "README.md").read_text()
    command = next(line for line in text.splitlines() if line.startswith("pip install"))
    return command.split("#")[0].split()[2:]


def siblings(package: str) -> set[str]:
    """The project's distributions that a package requires."""
    declared = tomllib.loads((PROJECT_ROOT / "packages" / package / "pyproject.toml").read_text())["project"]
    names = re.findall(r"endonav-(\w+)", " ".join(declared["dependencies"]))
    return {name for found in names for name in (found, *siblings(found))}


@pytest.mark.parametrize("package", DISTRIBUTIONS)
def test_the_command_of_a_readme_installs_what_no_index_has(package: str) -> None:
    folders = installing(package)
    assert set(folders) == {f"./packages/{name}" for name in (package, *siblings(package))}
    assert f"`{' '.join(folders)}`" in (PROJECT_ROOT / "docs" / "installation.md").read_text().replace(
        "pip install ", ""
    )
    if len(folders) > 1:
        assert f"`pip install {' '.join(folders)}`" in (PROJECT_ROOT / "README.md").read_text()


def plainly_configured() -> dict[str, str]:
    """The variables of a machine on which nobody has configured pip."""
    kept = ("PIP_CERT", "PIP_PROXY")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PIP_") or k in kept}
    return environment | {"PIP_CONFIG_FILE": os.devnull, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}


@pytest.mark.slow
def test_a_plainly_configured_pip_resolves_torch_and_what_the_project_pins(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--python", str(make_environment(tmp_path / "environment"))]
    reached = subprocess.run(
        [*pip, "--retries", "0", "--timeout", "15", "download", "-q", "--no-deps", "-d", tmp_path, "annotated-types"],
        env=plainly_configured(), capture_output=True, timeout=120, check=False,
    )  # fmt: skip
    if reached.returncode:
        pytest.skip("no index is reachable with pip as it comes")
    report = tmp_path / "report.json"
    command = [*pip, "install", "-q", "--dry-run", "--report", report, "-c", PROJECT_ROOT / "constraints.txt"]
    done = subprocess.run(
        [*command, *installing("splineformer")], cwd=PROJECT_ROOT, env=plainly_configured(), capture_output=True,
        text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    found = {one["metadata"]["name"]: one["metadata"]["version"] for one in json.loads(report.read_text())["install"]}
    assert {"endonav-guide3d", "endonav-splineformer", "torch"} <= found.keys()
    pins = (PROJECT_ROOT / "constraints.txt").read_text().lower().replace("_", "-")
    loose = [
        name
        for name, version in found.items()
        if not name.startswith(("endonav-", *CUDA_DISTRIBUTIONS))
        and f"\n{name}=={version}\n".lower().replace("_", "-") not in pins
    ]
    assert not loose


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all five distributions as their wheels unpack, built from copies of this tree."""
    folder = tmp_path_factory.mktemp("wheels")
    ignored = shutil.ignore_patterns("build", "*.so", "*.egg-info", "__pycache__")
    source = folder / "source"
    source.mkdir()
    for name in ("pipeline", "conf", *(f"packages/{name}" for name in DISTRIBUTIONS)):
        shutil.copytree(PROJECT_ROOT / name, source / name, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(PROJECT_ROOT / name, source / name)
    places = [source, *(source / "packages" / name for name in DISTRIBUTIONS)]
    pip = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
    done = subprocess.run(
        [*pip, "-w", folder / "wheels", *places], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    for wheel in (folder / "wheels").glob("*.whl"):
        zipfile.ZipFile(wheel).extractall(folder / "installed")
    shutil.rmtree(source)
    return folder / "installed"


@pytest.fixture(scope="module")
def wheels(installed: Path) -> dict[str, Path]:
    """The wheel of each distribution."""
    return {path.name.split("-")[0]: path for path in (installed.parent / "wheels").glob("*.whl")}


def run_installed(installed: Path, cwd: Path, *arguments: str) -> str:
    """Runs Python with the unpacked wheels and the libraries; -S leaves this tree's editable installs out."""
    libraries = Path(numpy.__file__).parents[1]
    environment = {**os.environ, "PYTHONPATH": f"{installed}:{libraries}", "CATHSIM_CACHE": str(cwd / "cache")}
    done = subprocess.run(
        [sys.executable, "-S", *arguments], cwd=cwd, env=environment, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
def test_the_pipeline_runs_from_its_wheel(installed: Path, tmp_path: Path) -> None:
    where = run_installed(installed, tmp_path, "-c", "import cathsim, enn, guide3d, pipeline; print(pipeline.__file__)")
    assert where.startswith(str(installed))
    told = run_installed(installed, tmp_path, "-m", "pipeline", "--help")
    for word in (*available_stages(), *BUDGETS, "demo"):
        assert word in told
    run_installed(installed, tmp_path, "-m", "pipeline", "stage=phantoms", "budget=smoke", "stage.phantoms=[type_1]")
    run_installed(installed, tmp_path, "-m", "pipeline", "stage=report", "budget=smoke")
    run = tmp_path / "runs" / "smoke"
    manifest = read_manifest(run / "phantoms")
    assert manifest is not None
    assert manifest.commits == ["unknown"]
    assert "Type" in (run / "report" / "index.html").read_text()


@pytest.mark.slow
def test_the_command_runs_from_its_wheel(installed: Path, tmp_path: Path) -> None:
    (entries,) = installed.glob("endonav-*.dist-info/entry_points.txt")
    assert "endonav = pipeline.command:main" in entries.read_text()
    assert "stages" in run_installed(installed, tmp_path, "-m", "pipeline.command", "--help")
    listed = run_installed(installed, tmp_path, "-m", "pipeline.command", "models")
    assert "guide3d reader: " in listed
    assert "stage=STAGE" in run_installed(installed, tmp_path, "-m", "pipeline.command", "stages")


@pytest.mark.slow
def test_native_wheels_are_for_every_python_and_one_platform(wheels: dict[str, Path]) -> None:
    tags = {name: path.stem.split("-")[2:] for name, path in wheels.items()}
    assert set(tags) == {"endonav", *(f"endonav_{name}" for name in DISTRIBUTIONS)}
    for name, (python, abi, platform) in tags.items():
        assert (python, abi) == ("py3", "none")
        assert (platform != "any") == (name in ("endonav_cathsim", "endonav_guide3d")), name


@pytest.mark.slow
def test_wheels_hold_every_data_file_of_the_tree(installed: Path) -> None:
    roots = {"pipeline": PROJECT_ROOT / "pipeline", "pipeline/conf": PROJECT_ROOT / "conf"}
    roots |= {name: PROJECT_ROOT / "packages" / name / "src" / name for name in DISTRIBUTIONS}
    for inside, root in roots.items():
        wanted = {
            path.relative_to(root) for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts
        }
        wanted = {path for path in wanted if path.suffix not in (".so", ".pyc") and "egg-info" not in str(path)}
        missing = sorted(str(path) for path in wanted if not (installed / inside / path).is_file())
        assert not missing, inside
