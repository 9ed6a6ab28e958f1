"""Settings that choose anatomies and targets: by name, a file of one's own, a random arch; a point, an entry.

They are declared here once. Stages inherit them, ``conf/anatomy/`` gives them the values of the command line
(``phantom.file=PATH``, ``phantom.name=…``, ``target=…``), and `settle` fills in what only the file tells. Names that
there are not are refused.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from annotated_types import Len

from pipeline.anatomies.anatomy_file import KINDS, AnatomyFile, in_settings, world_point
from pipeline.settings import kinds
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_anatomy
from pipeline.task import DESCENDING, Task, entry_place

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom


TARGETS = ("bca", "lcca", "lsa")  # that stages navigate to by themselves
GENERATED_TARGETS = (*TARGETS, "rsa", "rcca")  # that every generated arch has


def require_known_phantoms(names: Sequence[str]) -> None:
    """Refuses unknown names and lists the valid ones; random arches hold their seeds: random_7."""
    from cathsim.anatomy import PHANTOMS
    from cathsim.anatomy.generator.recipe import RANDOM
    from cathsim.anatomy.library import seed_in_name

    for name in names:
        if name in RANDOM:
            raise ConfigurationError(
                f"phantom {name!r} needs a seed: write {name}_7, or phantom.name={name} phantom.seed=7"
            )
    unknown = [name for name in names if name not in PHANTOMS and seed_in_name(name)[1] is None]
    if unknown:
        raise ConfigurationError(
            f"unknown phantom {', '.join(map(repr, unknown))}: choose from {', '.join(PHANTOMS)}, random_7"
        )


def require_known_targets(names: Sequence[str], phantoms: Sequence[str] = ()) -> None:
    """Refuses names that are no target's with a ConfigurationError that lists the valid ones.

    Args:
        phantoms: in which they are to be; then any target of theirs is taken, and any point as `target_name` writes it:
            point_27.0_-2.0_70.0_mm. Without, only those of every generated arch.
    """
    unknown = [name for name in names if name not in (TARGETS if phantoms else GENERATED_TARGETS)]
    for phantom in phantoms if unknown else ():
        from cathsim import load_phantom

        try:
            for name in unknown:
                load_phantom(phantom).target(name)
        except ValueError as error:
            raise ConfigurationError(str(error)) from error
    if unknown and not phantoms:
        raise ConfigurationError(
            f"unknown target {', '.join(map(repr, unknown))}: choose from {', '.join(GENERATED_TARGETS)}"
        )


def require_known_entry(entry: str, phantoms: Sequence[str]) -> None:
    """Refuses an entry that one of the phantoms does not have, with a ConfigurationError that lists the valid ones."""
    from cathsim import load_phantom

    try:
        for phantom in phantoms:
            load_phantom(phantom).entry(entry)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error


_LOGGER = logging.getLogger(__name__)

RANDOM = "random"  # arches like those of most patients
_OF_A_FILE = ("unit", "names", "labels", "transform", "extend", "ct")
_Coordinates = Annotated[list[float], Len(3, 3)]


@kinds.validated()
class FileSettings:
    """A file with an anatomy of one's own; results depend on what is in it, not on where it lies."""

    # The stage's setting which says that films, pictures or X-ray images show a CT; None: nothing does.
    shows_ct: ClassVar[str | None] = None

    file: kinds.PathText | None = field(default=None, metadata=kinds.NO_EFFECT_ON_RESULTS)  # as cathsim imports it
    unit: str | None = None  # of a surface
    names: kinds.BranchNames = None  # of its branches: a mapping from automatic names, or a list from the heart on
    labels: kinds.VesselLabels = None  # of a label volume: which label is which vessel
    # Which of a NIfTI file's two affines is taken.
    transform: Annotated[str, kinds.one_of("sform", "qform")] | None = None
    extend: bool | None = None  # whether branches that the file cuts short are extended; null: they are
    ct: kinds.PathText | None = field(default=None, metadata=kinds.NO_EFFECT_ON_RESULTS)  # that it was segmented from
    file_name: kinds.FolderName | None = None  # filled in, as the next: what its anatomy is called
    file_sha256: str | None = None
    ct_sha256: str | None = None

    def __post_init__(self) -> None:
        """Reads the file, and refuses what belongs to one where there is none."""
        self.file_name = self.file_sha256 = self.ct_sha256 = None
        if self.file is not None:
            if not (Path(self.file).is_file() or Path(self.file).is_dir()):
                raise ConfigurationError(f"phantom.file={self.file} is no file: give the path of a {KINDS}")
            self.file_name = AnatomyFile(self.file).name
            self.file_sha256 = hash_anatomy(Path(self.file))
        for name in _OF_A_FILE:
            if self.file is None and getattr(self, name) is not None:
                raise ConfigurationError(f"phantom.{name} belongs to a file: give phantom.file=PATH too")
        if self.ct is not None:
            if self.shows_ct is None:
                raise ConfigurationError(
                    "phantom.ct is shown by the stages phantoms, expert, rehearsal and unseen alone"
                )
            if not getattr(self, self.shows_ct):
                raise ConfigurationError(f"phantom.ct needs stage.{self.shows_ct}=true: give it, or leave out the CT")
            if not (Path(self.ct).is_file() or Path(self.ct).is_dir()):
                raise ConfigurationError(
                    f"phantom.ct={self.ct} is no file: give the path of the CT (NIfTI, NRRD, MetaImage, or the "
                    "folder of a DICOM series)"
                )
            self.ct_sha256 = hash_anatomy(Path(self.ct))

    @property
    def anatomy_file(self) -> AnatomyFile | None:
        """The file; None: there is none."""
        if self.file is None:
            return None
        further = {"ct": self.ct, "transform": self.transform, "extend": self.extend}
        return AnatomyFile.of(self.file, self.unit, self.names, self.labels, **further)


@kinds.validated()
class ChosenAnatomies(FileSettings):
    """Anatomies and targets of a stage, or the only one of each that the command line names."""

    needs_anatomy: ClassVar[bool] = True  # whether there must be one

    phantoms: kinds.FolderNames = field(default_factory=lambda: ["type_1", "type_2"])
    targets: kinds.TargetNames = field(default_factory=lambda: ["bca", "lcca"])
    phantom: kinds.FolderName | None = None  # phantom.name=…: the only one
    phantom_seed: kinds.Seed | None = None  # phantom.seed=…: of phantom.name=random, which may be left out
    target: kinds.TargetName | None = None  # target=…: the only one
    point_mm: _Coordinates | None = None  # the only target is a point: in the file's axes, else in the world frame
    entry: kinds.EntryPlace = None  # phantom.entry=…: its name, or a point as `point_mm`
    task: Task = field(default_factory=Task)

    def __post_init__(self) -> None:
        """Takes the choices of the command line over, and refuses what contradicts itself."""
        super().__post_init__()
        self._choose_anatomy()
        self._choose_target()
        if isinstance(self.entry, str) or (self.entry is not None and self.file is None):
            self.take_entry(self.entry if isinstance(self.entry, str) else _written(_metres(self.entry)))
            self.entry = None
        for key in ("phantoms", "targets"):
            if not getattr(self, key) and self.needs_anatomy:
                raise ConfigurationError(f"stage.{key} is empty: name at least one")

    def _choose_anatomy(self) -> None:
        if self.file_name is not None:
            if self.phantom is not None or self.phantom_seed is not None:
                raise ConfigurationError("phantom.file brings the anatomy: leave out phantom.name and phantom.seed")
            self.phantoms = [self.file_name]
        elif self.phantom_seed is not None:
            self.phantoms = [f"{self.phantom or RANDOM}_{self.phantom_seed}"]
        elif self.phantom is not None:
            self.phantoms = [self.phantom]
        self.phantom = self.phantom_seed = None  # so that a choice and the same list count as the same settings

    def _choose_target(self) -> None:
        if self.point_mm is not None and self.target is not None:
            raise ConfigurationError("stage.point_mm is the target: leave out target")
        if self.target is not None:
            self.take_targets([self.target])
        elif self.point_mm is not None and self.file is None:
            self.take_targets([_named(_metres(self.point_mm))])
            self.point_mm = None
        self.target = None

    def anatomy(self, name: str) -> str | AnatomyFile:
        """The anatomy of a name among `phantoms`: the file, where that is called so."""
        file = self.anatomy_file
        return file if file is not None and name == self.file_name else name

    def take_targets(self, names: list[str]) -> None:
        """Makes these the only targets."""
        self.targets = names

    def take_entry(self, entry: str) -> None:
        """Lets episodes begin there: a name, or the text of a point in m, world frame."""
        self.task = replace(self.task, entry=entry)

    def fit(self, phantom: Phantom) -> None:
        """Makes the wire as long as the file's vessels ask for, where its length is left open."""
        from pipeline.anatomies.devices import fitted_task

        usual = [target.name for target in phantom.targets.values() if not target.at_end]
        self.task = fitted_task(self.task, phantom, [*usual, *self.targets])

    def tested_targets(self) -> list[str]:
        """The targets in the anatomies of `phantoms`."""
        return self.targets

    def tested_entry(self) -> str:
        """The entry in the anatomies of `phantoms`."""
        return self.task.entry


def settle(settings: ChosenAnatomies) -> None:
    """Fills in what only the file tells: its points in the world frame, and the length of the wire."""
    from cathsim.anatomy.entry import entry_name

    file = settings.anatomy_file
    if file is None:
        return
    try:
        phantom = file.load()
        for note in phantom.imported.notes if phantom.imported else ():
            _LOGGER.info("%s: note: %s", settings.file_name, in_settings(note))
        file.background()  # now, and not after the work
        if settings.point_mm is not None:
            point = world_point(phantom, settings.point_mm)
            phantom.target(point)
            settings.take_targets([_named(point)])
            settings.point_mm = None
        if isinstance(settings.entry, list):
            settings.take_entry(_written(world_point(phantom, settings.entry)))
            settings.entry = None
        place = entry_place(settings.tested_entry())
        for target in settings.tested_targets():
            phantom.target(target)
            phantom.entry(entry_name(place, target))
        settings.fit(phantom)
    except ValueError as error:
        raise ConfigurationError(in_settings(error)) from error


def check_anatomies(settings: ChosenAnatomies) -> None:
    """Refuses unknown names of anatomies, targets and entries; those of a file are checked by `settle`."""
    if settings.file is not None:
        return
    require_known_phantoms(settings.phantoms)
    require_known_targets(settings.targets, settings.phantoms)
    if settings.task.entry != DESCENDING:
        require_known_entry(settings.task.entry, settings.phantoms)


def _metres(point_mm: Sequence[float]) -> list[float]:
    return [coordinate / 1e3 for coordinate in point_mm]


def _written(point: Sequence[float]) -> str:
    from cathsim.anatomy.entry import entry_name

    return entry_name(point)


def _named(point: Sequence[float]) -> str:
    from cathsim.anatomy.point_target import target_name

    x, y, z = point
    return target_name((x, y, z))
