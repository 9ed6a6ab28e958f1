"""Task of the stage `unseen`: targets in many anatomies, which these are, the environments, and clutter in images."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.anatomies.anatomy_file import AnatomyFile, load_anatomy
from pipeline.anatomies.devices import fitted_task, set_back_mm
from pipeline.stages.learning.task import REWARD_OF_EVALUATION, REWARD_OF_TRAINING
from pipeline.store.errors import ConfigurationError
from pipeline.task import DESCENDING, Task

if TYPE_CHECKING:
    from cathsim import Guidewire, NavigateEnv
    from cathsim.many_anatomies import NavigateManyEnv
    from cathsim.observations.scan import Scan
    from cathsim.observations.xray import Clutter, DrawClutter
    from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy


ROADMAP, IMAGE, XRAY = "roadmap", "image_true_mask", "xray"  # rows: what a policy sees
TEST_PHANTOM, VARIETY = "random", "arch_variety"
STEEP, TRUNK = "random_steep", "random_trunk"
_VARIETY_KINDS = tuple(f"{VARIETY}_{kind}" for kind in ("I", "II", "IV", "V", "VI", "VII"))
# kinds of the training's arches by turns: as tested, with rare shapes as often as common ones, and like scans
TRAINING_KINDS = {
    TEST_PHANTOM: (TEST_PHANTOM, "random_wide", TEST_PHANTOM, "random_scan", "random_scan"),
    STEEP: (STEEP, "random_scan", STEEP, "random_wide", TRUNK),
    TRUNK: (TRUNK, "random_scan", TRUNK, "random_wide", TEST_PHANTOM),
    VARIETY: _VARIETY_KINDS,
}
# Kinds of the tests' arches, which are drawn by turns.
TEST_KINDS = {TEST_PHANTOM: (TEST_PHANTOM,), STEEP: (STEEP,), TRUNK: (TRUNK,), VARIETY: _VARIETY_KINDS}
ROADMAP_KEYS = ("roadmap", "history")  # what a policy with a roadmap sees
RESOLUTION = 1e-3  # m: at 1.5 mm thin walls open, and ways become short cuts


def training_arch(seed: int, arches: str = TEST_PHANTOM) -> tuple[str, int]:
    """The training anatomy of a seed, its kind and the seed; `arches` is a name of TRAINING_KINDS."""
    kinds = TRAINING_KINDS[arches]
    return kinds[seed % len(kinds)], seed


def arch_of_test(seed: int, arches: str = TEST_PHANTOM) -> tuple[str, int]:
    """The anatomy of a test's seed, as of `training_arch`."""
    kinds = TEST_KINDS[arches]
    return kinds[seed % len(kinds)], seed


@dataclass(frozen=True)
class UnseenTask:
    """A task with several targets in many anatomies."""

    # names, each as likely in training; "point_1" and so on are points that each arch has of its own
    targets: tuple[str, ...]
    task: Task  # wire, images, limits and start; the wires of the tests are as long as its own
    accuracy: str = "fast"  # of the training's physics; tests always have the accurate one
    arches: str = TEST_PHANTOM  # that it takes place in, a name of TRAINING_KINDS

    def wire(self, kind: str) -> Guidewire:
        """A wire of the tests: a preset's name, or "softer" and "stiffer", half and twice as stiff as the task's."""
        factor = {"softer": 0.5, "stiffer": 2.0}.get(kind)
        if factor is None:
            return self.task.scaled(kind)
        wire = self.task.guidewire()
        return replace(
            wire,
            shaft_stiffness_nmm2=factor * wire.shaft_stiffness_nmm2,
            tip_stiffness_nmm2=factor * wire.tip_stiffness_nmm2,
        )

    def _catheter(self) -> dict[str, Any]:
        return {name: value for name, value in self.task.devices().items() if name != "wire"}

    def training_environment(
        self,
        anatomies: Sequence[int],
        observation: tuple[str, ...],
        accuracy: str | None = None,
        observe_every: int = 1,
    ) -> NavigateManyEnv:
        """An environment over random arches with the shaped reward; `observe_every` as of `cathsim.NavigateEnv`."""
        from cathsim.many_anatomies import NavigateManyEnv

        return NavigateManyEnv(
            [training_arch(seed, self.arches) for seed in anatomies],
            self.targets,
            (self.task.guidewire(),),
            resolution=RESOLUTION,
            **self._catheter(),
            accuracy=accuracy or self.accuracy,
            observation=observation,
            observe_every=observe_every,
            reward=REWARD_OF_TRAINING,
            **self.task.rules(),
        )

    def test_environment(
        self,
        phantom: str | int | AnatomyFile,
        target: str,
        wire: str,
        observation: tuple[str, ...],
        registration_noise: float = 0.0,
        entry: str = DESCENDING,
        scan: Scan | None = None,
        **physics: Any,
    ) -> NavigateEnv:
        """An environment of a test; `physics` as of `NavigateEnv`: `breathing`, `wall_stiffness`."""
        from cathsim import NavigateEnv

        if isinstance(phantom, int):
            phantom = "{}_{}".format(*arch_of_test(phantom, self.arches))
        place = load_anatomy(phantom)
        entry_task = replace(self, task=replace(self.task, entry=entry))
        if isinstance(phantom, AnatomyFile) or entry != DESCENDING or self.arches in (STEEP, TRUNK):
            fitted = fitted_task(replace(entry_task.task, wire_length_mm=0.0), place, [target])
            if fitted.guidewire().length > entry_task.task.guidewire().length:
                entry_task = replace(entry_task, task=fitted)
        return NavigateEnv(
            place,
            target=target,
            wire=entry_task.wire(wire),
            observation=observation,
            **entry_task._catheter(),
            reward=REWARD_OF_EVALUATION,
            registration_noise=registration_noise,
            scan=scan,
            **physics,
            **entry_task.task.rules(),
        )


_OFTEN = 10  # arches between two lines of the log

_LOGGER = logging.getLogger(__name__)


def with_steep_take_off(
    seeds: Iterable[int], targets: Sequence[str], least_mm: float, count: int, arches: str = TEST_PHANTOM
) -> list[int]:
    """The first so many seeds of arches with an ostium offset of `least_mm` or more; they are built on the way."""
    from cathsim import load_phantom

    def steep(seed: int) -> bool:
        kind, own = training_arch(seed, arches)
        phantom = load_phantom(kind, seed=own, resolution=RESOLUTION)
        return max(set_back_mm(phantom, target) for target in targets) >= least_mm

    steep_seeds = []
    for seed in islice(filter(steep, seeds), count):
        steep_seeds.append(seed)
        if len(steep_seeds) % _OFTEN == 0 or len(steep_seeds) == count:
            _LOGGER.info(
                "%d of %d arches with a target set back by %g mm: up to %d", len(steep_seeds), count, least_mm, seed
            )
    if len(steep_seeds) < count:
        raise ConfigurationError(
            f"only {len(steep_seeds)} of the arches have a target set back by {least_mm:g} mm, {count} are wanted: "
            "lower stage.least_set_back_mm or the number of arches"
        )
    return steep_seeds


_LARGEST_PX = 1024  # side of images of `guide3d.random_fluoroscopy`, whose clutter stands in the way of X-rays here


def require_clutter_fits(image_size_px: int, setting: str) -> None:
    """Refuses images, as of a setting, that are larger than those of random fluoroscopy, whose clutter they get."""
    if image_size_px > _LARGEST_PX:
        raise ConfigurationError(
            f"clutter is drawn in images of at most {_LARGEST_PX} px, got {setting}={image_size_px}: make them "
            "smaller, or give stage.clutter=0"
        )


def clutter_of(amount: float) -> DrawClutter | None:
    """Draws an episode's clutter: `amount` times as much as in the images that networks learn from; None for 0."""
    if not amount:
        return None
    from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
    from guide3d.random_fluoroscopy.settings import FluoroscopySettings

    # the vessels full of contrast medium are the simulator's
    return partial(_draw, RandomFluoroscopy(FluoroscopySettings(clutter=amount, contrast=0.0)))


def _draw(fluoroscopy: RandomFluoroscopy, generator: np.random.Generator, size: int) -> Clutter:
    return fluoroscopy.clutter(int(generator.integers(2**31)), size)
