"""The configuration of a run: what every run has, which stage has which settings, and their registration with Hydra.

The dataclasses own names, types, defaults and cross-checks. They live in importable modules, not in ``__main__``,
because the sweep launchers pickle them. YAML under ``conf/`` only chooses values. OmegaConf knows no Literal and turns
tuples into lists: choices are checks of the annotations.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from enn.curves import LOGGERS
from pipeline.jobs.engines.settings import LOCAL, SETTINGS
from pipeline.settings import kinds
from pipeline.stages import available_stages, settings_of
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task

_PACKAGE = Path(__file__).resolve().parent
# Inside the package where it was installed from a wheel, beside it in a checkout.
CONFIG_DIRECTORY = _PACKAGE / "conf" if (_PACKAGE / "conf").is_dir() else _PACKAGE.parent / "conf"
BUDGETS = ("smoke", "desk", "thesis")

# What is chosen by name, where the names are no files of `conf/`.
CHOICES = {
    "stage": available_stages(),
    "budget": BUDGETS,
    "engine": tuple(SETTINGS),
    "hydra/launcher": ("basic", "joblib", "ray", "submitit_local", "submitit_slurm"),
}


@kinds.validated("phantom.")
class OwnPhantom:
    """The only anatomy: a file's by ``phantom.file=PATH``, or one of the library by ``phantom.name=NAME``."""

    name: kinds.FolderName | None = None  # a named anatomy, random_7, or random with a seed
    seed: kinds.Seed | None = None
    file: kinds.PathText | None = None  # any that cathsim imports: surface, label volume, folder
    unit: str | None = None  # of a surface: m, cm, mm or inch; detected when left out
    names: kinds.BranchNames = None
    labels: kinds.VesselLabels = None
    transform: str | None = None  # of NIfTI files: sform or qform, which of their affines is taken
    extend: bool | None = None  # whether branches that the file cuts short are extended; null: they are
    ct: kinds.PathText | None = None  # that the file was segmented from: shown by films and X-ray images
    entry: kinds.EntryPlace = None  # access site; null: descending


@kinds.validated("guide3d.")
class Guide3dSource:
    """A data set of one's own: the top-level keys ``guide3d.root=PATH`` and its like."""

    root: kinds.PathText | None = None  # folder in the public layout, or its raw.json
    images: kinds.PathText | None = None  # folder of the images, where they lie elsewhere
    # folder of the camera files (and perforated sheets), where they lie elsewhere
    calibration: kinds.PathText | None = None
    undistorted: bool | None = None  # whether annotations are undistorted; found out by epipolar residuals if left out


@kinds.validated("")
class RunConfig:
    """One run of one stage."""

    stage: Any = MISSING  # one of the settings above
    phantom: OwnPhantom = field(default_factory=OwnPhantom)
    guide3d: Guide3dSource = field(default_factory=Guide3dSource)  # a bi-planar data set of one's own
    task: Task = field(default_factory=Task)  # that stages take over as stage.task
    target: kinds.TargetName | None = None  # the only target of the learning stages: made for sweeps, target=bca,lcca
    modality: kinds.FolderName | None = None  # the only modality set of the stage enn: modality=I,V,I+V+M
    # stages take networks and policies that come with the packages in place of trainings that these would repeat
    pretrained: bool = False
    budget: dict[str, Any] = field(default_factory=dict)  # conf/budget/*.yaml
    name: kinds.FolderName = "${budget.name}"  # the run folder below runs_dir
    runs_dir: kinds.PathText = "runs"
    seed: kinds.Seed = 0
    engine: Any = None  # where jobs run: settings of pipeline.jobs.engines.settings; null: on this machine
    force: bool = False  # run even when the results are up to date
    logger: Annotated[str, kinds.one_of(*LOGGERS)] = LOGGERS[0]  # that takes the curves of trainings
    films: kinds.CountOrNone = 0  # evaluations of a policy's training from one film of an episode to the next; 0: none

    @property
    def budget_name(self) -> str:
        """The budget's name, e.g. ``desk``."""
        return str(self.budget.get("name", "unnamed"))


def register_schemas(stages: Iterable[str] | None = None) -> None:
    """Makes the dataclasses known to Hydra, so that a wrong key or type is refused when the configuration is composed.

    The stages' schemas sit in a group of their own: in ``stage`` they would show up as stages a user can choose.
    """
    # Hydra makes its folder of these names before the values are checked.
    OmegaConf.register_new_resolver("hydra_folder", _hydra_folder, replace=True)
    _register_run()
    for name in available_stages() if stages is None else stages:
        _register_stage(name)


@functools.cache
def _register_run() -> None:
    store = ConfigStore.instance()
    store.store(name="schema", node=RunConfig)
    for name, settings in SETTINGS.items():
        store.store(group="schema/engine", name=name, node=settings)
    _register_sizes("task")


@functools.cache
def _register_stage(name: str) -> None:
    ConfigStore.instance().store(group="schema/stage", name=name, node=settings_of(name))
    _register_sizes(name)


def _register_sizes(owner: str) -> None:
    """Registers what budgets and experiments change in a stage, or in the run's task."""
    store = ConfigStore.instance()
    for choice, sizes in _sizes().items():
        values = sizes.get(owner)
        task = None if values is None else values.pop("task", None)  # the run's, so that task.KEY=… is last
        for group, node in (("sizes", values), ("task_sizes", task)):
            for kind in ("", "experiment_") if node is not None else ():
                store.store(group=f"{kind}{group}", name=f"{choice}_{owner}", node=node)


@functools.cache
def _sizes() -> dict[str, Any]:
    return {file.stem: OmegaConf.load(file) for file in (CONFIG_DIRECTORY / "sizes").glob("*.yaml")}


def _hydra_folder(runs_dir: str, name: str, stage: str) -> str:
    for setting, value, check in (("runs_dir", runs_dir, kinds.path_text), ("name", name, kinds.folder_name),
                                  ("stage.name", stage, kinds.folder_name)):  # fmt: skip
        try:
            check(str(value))
        except ValueError as error:
            raise ConfigurationError(f"{setting} {error}") from error
    return f"{runs_dir}/{name}/.hydra/{stage}"


def run_config(composed: DictConfig) -> RunConfig:
    """Turns the configuration that Hydra composed, without its own ``hydra`` node, into checked dataclasses."""
    OmegaConf.to_object(composed.phantom)  # first, for the stages take its values over under other names
    config = OmegaConf.to_object(composed)
    if not isinstance(config, RunConfig):
        raise ConfigurationError(
            "the configuration was composed without its schema: keep `- schema` in conf/config.yaml"
        )
    if config.stage.name != type(config.stage).name:
        raise ConfigurationError(f"stage.name cannot be {kinds.shown(config.stage.name)}: choose a stage by stage=NAME")
    # `+key=value` adds keys past the schema: refused here, or a misspelt setting would pass unnoticed.
    _refuse_unknown("", composed, config)
    return config


def _refuse_unknown(prefix: str, node: DictConfig, made: Any) -> None:
    """Refuses keys that a dataclass, or one that it holds, does not have."""
    names = [item.name for item in dataclasses.fields(made)]
    extra = [str(key) for key in node if key not in names]
    if extra:
        raise ConfigurationError(f"unknown setting {prefix + extra[0]!r}: choose one of {', '.join(names)}")
    for name in names:
        if dataclasses.is_dataclass(getattr(made, name)):
            _refuse_unknown(f"{prefix}{name}.", node[name], getattr(made, name))


def choices(group: str) -> Sequence[str]:
    """The names to choose from in a group of the configuration; none where there is no such group."""
    return CHOICES.get(group) or sorted(file.stem for file in (CONFIG_DIRECTORY / group).glob("*.yaml"))


def settings_beside(key: str, choices: Mapping[str, str]) -> list[str]:
    """The settings beside a key such as ``stage.task.wire``, real or not; `chosen`: group to choice, if known."""
    owner, stage = key.rpartition(".")[0], choices.get("stage", "")
    if owner.rpartition(".")[2] in ("task", "arch_task"):
        return [f"{owner}.{item.name}" for item in dataclasses.fields(Task)]
    kinds_of: dict[str, Any] = {item.name: item.default_factory for item in dataclasses.fields(RunConfig)}
    if dataclasses.is_dataclass(settings := kinds_of.get(owner)):
        return [f"{owner}.{item.name}" for item in dataclasses.fields(settings)]
    if not key.startswith(("stage.", "engine.")):
        return [*(item.name for item in dataclasses.fields(RunConfig)), "experiment", "stage.KEY"]
    group = key.partition(".")[0]
    if group == "stage":
        fields = dataclasses.fields(settings_of(stage)) if stage in available_stages() else ()
    else:
        fields = dataclasses.fields(SETTINGS.get(choices.get("engine", ""), SETTINGS[LOCAL]))
    return [f"{group}.{item.name}" for item in fields if item.name != "name"]


def anatomy_not_taken(config: RunConfig) -> list[str]:
    """Settings of an anatomy that were given, in a stage whose anatomies are those of its own settings alone."""
    names = {item.name for item in dataclasses.fields(config.stage)}
    if not names & {"phantom", "phantoms"}:
        return []
    keys = [item.name for item in dataclasses.fields(config.phantom) if getattr(config.phantom, item.name) is not None]
    # one that is chosen by name, seed and entry, and one of a file
    unused = [name for name in keys if ("entry" if name in ("name", "seed", "entry") else "file") not in names]
    targets = ["target"] if config.target is not None and "targets" in names and "entry" not in names else []
    return [*(f"phantom.{name}" for name in unused), *targets]
