"""The registry of stages, found by scanning this folder; a stage is imported only when it is chosen.

A stage is two files: ``conf/stage/<name>.yaml`` and a module of this package, ``<name>.py`` or ``<name>/stage.py``,
that ends with ``STAGE = Stage(...)``. Names and order are read from those declarations, so `--help` imports no stage.
"""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.printing import installing
from pipeline.settings.checks import shown
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.run_folder import RunFolder

_DECLARATION = "\nSTAGE = "
_PLACE_BY_DEFAULT = 50


@dataclass(frozen=True)
class StageContext:
    """What a stage is given beside its settings."""

    folder: RunFolder  # where it writes; also lends resumable items
    run_path: Path  # runs/<name>
    inputs: dict[str, Path]  # earlier stage -> its folder
    budget: str
    seed: int

    @property
    def path(self) -> Path:
        """The stage's own folder."""
        return self.folder.path


def no_check(settings: Any) -> None:
    """Accepts any settings: for stages whose settings dataclass says it all."""


def as_given(settings: Any) -> None:
    """Leaves settings as they are: for stages whose settings tell everything without a file being read."""


def no_further_inputs(run_path: Path) -> dict[str, str]:
    """Depends on nothing beyond the stages it reads."""
    return {}


@dataclass(frozen=True)
class Stage:
    """A step from files to files. `reads` and `place` are literals: they are read without importing the module."""

    settings: type  # declared with `validated`; its field `name` is the stage's name
    run: Callable[[Any, StageContext], None]  # settings, context
    version: int = 1  # raised by hand where the same settings and inputs give results of another meaning
    reads: tuple[str, ...] = ()  # stages that must have finished
    writes: tuple[str, ...] = ()  # what lies in its folder afterwards
    prepare: Callable[[Any], None] = as_given  # fills in what only reading files tells, before `check`
    check: Callable[[Any], None] = no_check  # refuses settings with a ConfigurationError before anything is written
    seeded: bool = True  # whether its results depend on the run's seed: then each seed has a folder of its own
    repeated: bool = False  # whether a chain over several seeds repeats it: its figures differ from seed to seed
    further_inputs: Callable[[Path], dict[str, str]] = no_further_inputs  # hashes of whatever else it reads
    uses: tuple[str, ...] = ()  # stages whose results it takes where they are there
    gathers: bool = False  # whether it reads whatever has finished: in a chain it waits for all before it
    place: int = _PLACE_BY_DEFAULT  # among stages that could run at the same time: the smallest comes first

    @property
    def name(self) -> str:
        """The stage's name."""
        return str(self.settings.name)  # type: ignore[attr-defined]


def available_stages() -> tuple[str, ...]:
    """Names all stages, each after those that it reads; of several that could be next, by `place`, then by name."""
    return tuple(_modules())


def stage_module(name: str) -> str:
    """Import name of a stage's module, e.g. ``pipeline.stages.unseen.stage``.

    Raises:
        ConfigurationError: for an unknown name; the message lists the valid ones.
    """
    modules = _modules()
    if name not in modules:
        raise ConfigurationError(f"unknown stage {name!r}: choose one of {', '.join(modules)}")
    return modules[name]


def load_stage(name: str) -> Stage:
    """Imports one stage.

    Raises:
        ConfigurationError: for an unknown name; the message lists the valid ones.
        StageError: when the stage needs a package that is not installed.
    """
    stage: Stage = _imported(name, stage_module(name), "STAGE")
    return stage


def settings_of(name: str) -> type:
    """The dataclass of a stage's settings; where a module beside the stage declares it, the stage is not imported.

    Raises:
        ConfigurationError: for an unknown name; the message lists the valid ones.
        StageError: when the stage needs a package that is not installed.
    """
    module = stage_module(name)
    file = Path(__file__).parent.joinpath(*module.removeprefix(__name__).split(".")).with_suffix(".py")
    text = file.read_text(encoding="utf-8")
    declared = _keywords(text.partition(_DECLARATION)[2])["settings"]
    for node in ast.parse(text).body:
        if isinstance(node, ast.ImportFrom) and ast.unparse(declared) in (alias.name for alias in node.names):
            settings: type = _imported(name, node.module or "", ast.unparse(declared))
            return settings
    return load_stage(name).settings


def _imported(stage: str, module: str, name: str) -> Any:
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        raise missing_module(stage, error) from error


def missing_module(stage: str, error: ModuleNotFoundError) -> StageError:
    """The error to raise where a stage needs a package that is not installed."""
    return StageError(
        f"stage {stage} needs the module {error.name!r}, which is not installed: run `{installing('make setup')}`"
    )


@functools.cache
def _modules() -> Mapping[str, str]:
    """Stage to import name of its module, in the order of `available_stages`."""
    folder = Path(__file__).parent
    modules, declared = {}, {}
    for file in (*folder.glob("*.py"), *folder.glob("*/stage.py")):
        _, found, declaration = file.read_text(encoding="utf-8").partition(_DECLARATION)
        if found:
            name, inside = (file.stem, "") if file.parent == folder else (file.parent.name, ".stage")
            modules[name] = f"{__name__}.{name}{inside}"
            words = _keywords(declaration)
            declared[name] = {word: ast.literal_eval(words[word]) for word in ("reads", "place") if word in words}
    graph = graphlib.TopologicalSorter({name: values.get("reads", ()) for name, values in declared.items()})
    graph.prepare()
    ready, order = [*graph.get_ready()], {}
    while ready:
        ready.sort(key=lambda name: (declared[name].get("place", _PLACE_BY_DEFAULT), name))
        first = ready.pop(0)
        order[first] = modules[first]
        graph.done(first)
        ready += graph.get_ready()
    return order


def _keywords(declaration: str) -> dict[str | None, ast.expr]:
    """The keywords of the call that a text begins with."""
    statement = ast.parse(declaration).body[0]
    if not isinstance(statement, ast.Expr) or not isinstance(statement.value, ast.Call):
        raise TypeError(f"STAGE must be Stage(...), got {shown(declaration)}")
    return {word.arg: word.value for word in statement.value.keywords}
