"""Distributions are complete: built and used with what they declare alone, not from this tree; all is pinned."""

import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename

from pipeline.config import BUDGETS
from pipeline.stages import available_stages
from pipeline.store.manifest import read_manifest

PROJECT_ROOT = Path(__file__).resolve().parents[2]
DISTRIBUTIONS = ("cathsim", "enn", "guide3d", "splineformer")
# What torch brings where its build has CUDA, and what it is called with other versions of CUDA.
CUDA_DISTRIBUTIONS = ("nvidia-", "cuda-", "triton")

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
print(cathsim.__file__)
"""


def declared(package: str) -> dict:
    """What a package's pyproject.toml says."""
    return tomllib.loads((PROJECT_ROOT / "packages" / package / "pyproject.toml").read_text())


def needed(requirements: Iterable[str]) -> dict[str, importlib.metadata.Distribution]:
    """The installed distributions of others that requirements lead to, by name; wrong versions of them fail."""
    found: dict[str, importlib.metadata.Distribution] = {}
    seen: set[tuple[str, str]] = set()
    pending = [Requirement(line) for line in requirements]
    while pending:
        requirement = pending.pop()
        name = canonicalize_name(requirement.name)
        if name.startswith("endonav-"):
            project = declared(name.removeprefix("endonav-"))["project"]
            optional = project.get("optional-dependencies", {})
            pending += map(Requirement, sum((optional[extra] for extra in requirement.extras), project["dependencies"]))
            continue
        found[name] = importlib.metadata.distribution(name)
        assert requirement.specifier.contains(found[name].version, prereleases=True), requirement
        for extra in {"", *requirement.extras} - {extra for known, extra in seen if known == name}:
            seen.add((name, extra))
            lines = map(Requirement, found[name].requires or ())
            pending += [one for one in lines if one.marker is None or one.marker.evaluate({"extra": extra})]
    return found


def environment_of(folder: Path, distributions: Iterable[importlib.metadata.Distribution]) -> tuple[Path, Path]:
    """Makes a virtual environment that holds links to some of this environment's distributions alone.

    Returns:
        Its Python and its folder of modules.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, capture_output=True, timeout=60)
    (modules,) = folder.glob("lib/python*/site-packages")
    for one in distributions:
        for name in {file.parts[0] for file in one.files or ()} - {"..", "__pycache__"}:
            if not (modules / name).exists():
                (modules / name).symlink_to(Path(str(one.locate_file(name))).resolve())
    return folder / "bin" / "python", modules


def run(command: list, cwd: Path, **variables: str) -> str:
    """Runs a command outside this tree and gives what it printed."""
    variables["PYTHONDONTWRITEBYTECODE"] = ""  # the next start need not compile again
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | variables
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


# Ends once all is resolved, and names the files: pip would download gigabytes of them. Compares the platforms of 30,000
# files with a set, not with a list of a thousand.
PIP = """
import os
from pip._internal.cli.main import main
from pip._internal.models.wheel import Wheel
from pip._internal.operations.prepare import RequirementPreparer
def named(preparer, requirements, **_):
    print(*(one.link.filename for one in requirements), flush=True)
    os._exit(0)
RequirementPreparer.prepare_linked_requirements_more = named
sets = {}
def supported(wheel, tags):
    if id(tags) not in sets:
        sets[id(tags)] = tags, frozenset(tags)
    return not wheel.file_tags.isdisjoint(sets[id(tags)][1])
Wheel.supported = supported
raise SystemExit(main())
"""


@pytest.fixture(scope="module", autouse=True)
def resolving(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str] | None]:
    """A plainly configured pip that resolves torch while the other tests build; None where it reaches no index."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PIP_") or k in ("PIP_CERT", "PIP_PROXY")}
    environment |= {"PIP_CONFIG_FILE": os.devnull, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    pip = [sys.executable, "-c", PIP]
    tried = ["--retries=0", "--timeout=15", "download", "--no-deps", "-d", tmp_path_factory.mktemp("pip")]
    if subprocess.run([*pip, *tried, "annotated-types"], env=environment, capture_output=True, check=False).returncode:
        yield None
        return
    wanted = [one for name in ("guide3d", "splineformer") for one in declared(name)["project"]["dependencies"]]
    wanted = [one for one in wanted if not one.startswith("endonav-")]
    how = ("--use-feature=fast-deps", "--dry-run", "--ignore-installed", "-c", PROJECT_ROOT / "constraints.txt")
    with subprocess.Popen(
        [*pip, "install", *how, *wanted], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as started:
        yield started
        started.kill()


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The wheel of each distribution, built from a copy of this tree where there is only what its build requires."""
    folder = tmp_path_factory.mktemp("wheels")
    # a copy: building leaves files beside the sources, and stale ones there would end up in later builds
    ignored = shutil.ignore_patterns("build", "*.so", "*.egg-info", "__pycache__")
    for name in ("pipeline", "conf", "evaluation", *(f"packages/{name}" for name in DISTRIBUTIONS)):
        shutil.copytree(PROJECT_ROOT / name, folder / "source" / name, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(PROJECT_ROOT / name, folder / "source" / name)
    places: dict[tuple[str, ...], list[Path]] = {}  # by what their builds require
    for place in (folder / "source", *(folder / "source" / "packages" / name for name in DISTRIBUTIONS)):
        required = tomllib.loads((place / "pyproject.toml").read_text())["build-system"]["requires"]
        places.setdefault(tuple(sorted(required)), []).append(place)
    for number, (required, alike) in enumerate(places.items()):
        python, _ = environment_of(folder / "environments" / str(number), needed(required).values())
        pip = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check"]
        run([*pip, "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder / "wheels", *alike], folder)
    return {path.name.split("-")[0]: path for path in (folder / "wheels").glob("*.whl")}


@pytest.fixture(scope="module")
def installed(wheels: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all five distributions as their wheels unpack."""
    folder = tmp_path_factory.mktemp("installed")
    for wheel in wheels.values():
        zipfile.ZipFile(wheel).extractall(folder)
    return folder


@pytest.mark.slow
def test_cathsim_installs_alone_with_its_native_code(wheels: dict[str, Path], tmp_path: Path) -> None:
    required = needed(declared("cathsim")["project"]["dependencies"])
    assert not required.keys() & {"torch", "torchvision", "hydra-core", "stable-baselines3"}
    python, modules = environment_of(tmp_path / "environment", required.values())
    zipfile.ZipFile(wheels["endonav_cathsim"]).extractall(modules)
    assert str(modules) in run([python, "-c", USE_CATHSIM], tmp_path, CATHSIM_CACHE=str(tmp_path / "cache"))


def siblings(package: str) -> set[str]:
    """The project's distributions that a package requires."""
    names = re.findall(r"endonav-(\w+)", " ".join(declared(package)["project"]["dependencies"]))
    return {name for found in names for name in (found, *siblings(found))}


@pytest.mark.parametrize("package", DISTRIBUTIONS)
def test_the_command_of_a_readme_installs_what_no_index_has(package: str) -> None:
    text = (PROJECT_ROOT / "packages" / package / "README.md").read_text()
    command = next(line for line in text.splitlines() if line.startswith("pip install"))
    folders = command.split("#")[0].split()[2:]
    assert set(folders) == {f"./packages/{name}" for name in (package, *siblings(package))}


@pytest.mark.parametrize("package", DISTRIBUTIONS)
def test_all_that_a_package_needs_is_pinned(package: str) -> None:
    pins = (PROJECT_ROOT / "constraints.txt").read_text().lower().replace("_", "-").splitlines()
    versions = {name: one.version.split("+")[0] for name, one in needed([f"endonav-{package}"]).items()}
    loose = [f"{name}=={version}" for name, version in versions.items() if not name.startswith(CUDA_DISTRIBUTIONS)]
    assert not {*loose} - {*pins}


def run_installed(installed: Path, cwd: Path, *arguments: str) -> str:
    """Runs Python with the unpacked wheels and the libraries; -S leaves this tree's editable installs out."""
    libraries = Path(numpy.__file__).parents[1]
    paths = f"{installed}:{libraries}"
    return run([sys.executable, "-S", *arguments], cwd, PYTHONPATH=paths, CATHSIM_CACHE=str(cwd / "cache"))


@pytest.mark.slow
def test_the_pipeline_and_its_command_run_from_their_wheels(installed: Path, tmp_path: Path) -> None:
    (entries,) = installed.glob("endonav-*.dist-info/entry_points.txt")
    assert "endonav = pipeline.command:main" in entries.read_text()
    told = run_installed(installed, tmp_path, "-m", "pipeline", "--help")
    for word in (*available_stages(), *BUDGETS, "demo", "--multirun"):
        assert word in told
    commands = ["models", "evaluate --list", "stages budget=smoke stage=phantoms stage.phantoms=[type_1]"]
    commands = [command.split() for command in (*commands, "stages budget=smoke stage=report")]
    code = f"from pipeline.command import main\nassert not any(map(main, {commands}))"
    told = run_installed(installed, tmp_path, "-c", code)
    assert "guide3d reader: " in told
    assert "random_roadmap: " in told
    run = tmp_path / "runs" / "smoke"
    manifest = read_manifest(run / "phantoms")
    assert manifest.commits == ["unknown"]  # not this tree's
    assert "Type" in (run / "report" / "index.html").read_text()


@pytest.mark.slow
def test_native_wheels_are_for_every_python_and_one_platform(wheels: dict[str, Path]) -> None:
    tags = {name: path.stem.split("-")[2:] for name, path in wheels.items()}
    assert set(tags) == {"endonav", *(f"endonav_{name}" for name in DISTRIBUTIONS)}
    for name, (python, abi, platform) in tags.items():
        assert (python, abi) == ("py3", "none")
        assert (platform != "any") == (name in ("endonav_cathsim", "endonav_guide3d")), name


@pytest.mark.slow
def test_wheels_hold_every_data_file_of_the_tree(installed: Path) -> None:
    roots = {"pipeline": PROJECT_ROOT / "pipeline"}
    roots |= {f"pipeline/{name}": PROJECT_ROOT / name for name in ("conf", "evaluation")}
    roots |= {name: PROJECT_ROOT / "packages" / name / "src" / name for name in DISTRIBUTIONS}
    for inside, root in roots.items():
        wanted = {
            path.relative_to(root) for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts
        }
        wanted = {path for path in wanted if path.suffix not in (".so", ".pyc") and "egg-info" not in str(path)}
        missing = sorted(str(path) for path in wanted if not (installed / inside / path).is_file())
        assert not missing, inside


@pytest.mark.slow
def test_a_plainly_configured_pip_resolves_torch_and_what_the_project_pins(
    resolving: subprocess.Popen[str] | None,
) -> None:
    if resolving is None:
        pytest.skip("no index is reachable with pip as it comes")
    out, errors = resolving.communicate(timeout=300)
    assert resolving.returncode == 0, errors[-2000:]
    found = dict(map(str, parse_wheel_filename(one)[:2]) for one in out.splitlines()[-1].split())
    assert "torch" in found
    pins = (PROJECT_ROOT / "constraints.txt").read_text().lower().replace("_", "-")
    named = {f"{name}=={version}" for name, version in found.items() if not name.startswith(CUDA_DISTRIBUTIONS)}
    assert not named - {*pins.splitlines()}
