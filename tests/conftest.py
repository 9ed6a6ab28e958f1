"""Fixtures shared by all tests: a command line of the pipeline in a process of its own, in a folder of its own."""

import contextlib
import gc
import io
import locale
import logging
import os
import re
import resource
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

PROJECT_ROOT = Path(__file__).resolve().parent.parent

# Before numpy or torch is imported anywhere: tests run beside each other and beside other work.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Ray's workers have a niceness of 15 otherwise, and starve where other tests keep all cores busy.
os.environ.setdefault("RAY_worker_niceness", "0")
# A make that a test starts is no part of the make that runs the tests, whose variables it would take over.
for _name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "MAKEOVERRIDES", "ARGS", "NAME", "BUDGET", "SEEDS", "BESIDE", "DEMO"):
    os.environ.pop(_name, None)


# Tests that neither train, simulate, import a surface nor start a process; `make check` leaves out all others.
FAST = re.compile(
    r"cathsim/(devices/test_device|fluoroscopy/test_(?!biplane)|lattice|metrics|test_guidewire)"
    r"|enn/(networks|reinforcement/test_(replay|reset)|test_(policy|traj))"
    r"|guide3d/(dataset|dicom|geometry|learning/test_losses|modeling|test_image)"
    r"|splineformer/(modeling|navigation|test_(image|tokens))"
    r"|integration/(documents|test_(files|import|versions))|pipeline/(report/test_(?!learning)|settings/test_quoting)"
)


def fast(path: Path) -> bool:
    """Whether a module's tests are fast, but for those that are marked as slow."""
    tests = PROJECT_ROOT / "tests"
    return path.is_relative_to(tests) and FAST.match(path.relative_to(tests).as_posix()) is not None


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts files with marked tests first: begun last, one of them would keep one worker busy at the end."""
    marked = {item.path for item in items if item.get_closest_marker("slow") is not None}
    items.sort(key=lambda item: item.path not in marked)
    for item in items:
        if not fast(item.path):
            item.add_marker("slow")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leaves modules unread all of whose tests would be left out: importing them takes half a minute."""
    unwanted = config.option.markexpr == "not slow" and collection_path.name.startswith("test_")
    return True if unwanted and not fast(collection_path) else None


def pytest_collectstart() -> None:
    """Looks for no garbage until all modules are imported: it would go through all that they make again and again."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Leaves what the modules made out of every later look for garbage."""
    gc.freeze()
    gc.enable()


LOCALE = locale.setlocale(locale.LC_CTYPE)


@pytest.fixture(autouse=True)
def locale_as_before() -> Iterator[None]:
    """Undoes a switch of the process's locale, as some libraries make, and names the test."""
    yield
    if (found := locale.setlocale(locale.LC_CTYPE)) != LOCALE:
        locale.setlocale(locale.LC_CTYPE, LOCALE)
        warnings.warn(f"the process's locale was switched from {LOCALE} to {found}", stacklevel=1)


@contextlib.contextmanager
def process_kept() -> Iterator[None]:
    """Undoes what a command line run in this process sets: loggers' levels and handlers, and what signals do.

    Handlers made before are kept from Hydra, which closes all that logging knows: absl's would close pytest's capture.
    """
    logging._handlerList.clear()
    stops = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)}
    unraisable = sys.unraisablehook
    root, manager = logging.getLogger(), logging.root.manager
    level, handlers, threshold = root.level, root.handlers[:], manager.disable
    known = {
        name: (logger.level, logger.handlers[:], logger.propagate, logger.disabled)
        for name, logger in manager.loggerDict.items()
        if isinstance(logger, logging.Logger)
    }
    yield
    for number, handler in stops.items():
        signal.signal(number, handler)
    sys.unraisablehook = unraisable
    root.level, root.handlers[:], manager.disable = level, handlers, threshold
    for name, logger in manager.loggerDict.items():
        if isinstance(logger, logging.Logger):
            before = known.get(name, (logging.NOTSET, [], True, False))
            logger.level, logger.handlers[:], logger.propagate, logger.disabled = before
            logger._cache.clear()
    root._cache.clear()


@pytest.fixture(autouse=True)
def process_as_before() -> Iterator[None]:
    """Every test leaves the process as it was."""
    with process_kept():
        yield


@dataclass(frozen=True)
class PipelineProcess:
    """Starts ``python -m pipeline`` with its runs below a temporary folder."""

    folder: Path
    environment: dict[str, str] = field(default_factory=os.environ.copy)

    @property
    def runs(self) -> Path:
        """Where the runs go."""
        return self.folder / "runs"

    def run(self, *overrides: str, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
        """Runs a command line to its end."""
        return subprocess.run(
            self._command(overrides),
            cwd=PROJECT_ROOT,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def run_here(self, *overrides: str) -> subprocess.CompletedProcess[str]:
        """Runs a command line to its end in this process, where a start of Python is not what is tested."""
        from pipeline.launch import main

        out, errors = io.StringIO(), io.StringIO()
        with (
            process_kept(),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(errors),
        ):
            code = main(self._arguments(overrides))
        return subprocess.CompletedProcess(overrides, code, out.getvalue(), errors.getvalue())

    def start(
        self, *overrides: str, largest_file: int | None = None, interpreter_options: tuple[str, ...] = ()
    ) -> subprocess.Popen[str]:
        """Starts a command line; the caller stops it. No file it writes may exceed ``largest_file`` bytes."""

        def before_it_runs() -> None:
            # A shell that started the tests in the background made them ignore Ctrl-C: children would inherit that.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            if largest_file is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))

        return subprocess.Popen(
            self._command(overrides, interpreter_options),
            cwd=PROJECT_ROOT,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=before_it_runs,
        )

    def _command(self, overrides: tuple[str, ...], interpreter_options: tuple[str, ...] = ()) -> list[str]:
        return [sys.executable, *interpreter_options, "-m", "pipeline", *self._arguments(overrides)]

    def _arguments(self, overrides: tuple[str, ...]) -> list[str]:
        return [*overrides] if "--help" in overrides else [*overrides, f"runs_dir={self.runs}"]


@pytest.fixture(scope="session", autouse=True)
def anatomy_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of anatomies for the test session and all its workers: tests neither see nor fill the user's own."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "anatomy_cache"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CATHSIM_CACHE", str(folder))
        yield folder


@pytest.fixture
def pipeline_process(tmp_path: Path) -> PipelineProcess:
    """A pipeline that writes below the test's temporary folder."""
    return PipelineProcess(tmp_path)


@pytest.fixture(scope="session")
def run_python() -> Callable[[str], str]:
    """Runs a snippet in a fresh interpreter and returns what it printed; the test fails when the snippet does."""

    def run(snippet: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", snippet], cwd=PROJECT_ROOT, capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run
