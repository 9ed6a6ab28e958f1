"""Which random arches the stage `unseen` trains in and chooses its best policy by; those with a steep take-off."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from itertools import islice

from pipeline.anatomies.take_offs import set_back_mm
from pipeline.seeds import training_arches, validation_arches
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import RESOLUTION, TEST_PHANTOM, VARIETY, training_arch
from pipeline.store.errors import ConfigurationError

_MOST_TRIED = 1_000  # arches, to find those with a steep take-off
_OFTEN = 10  # arches between two lines of the log

_LOGGER = logging.getLogger(__name__)


def arches_of(settings: UnseenSettings, run_seed: int, count: int) -> tuple[list[int], list[int]]:
    """The arches that are trained in, so many, and those that choose the best policy."""
    least, chosen_by = settings.least_set_back_mm, settings.validation_anatomies
    every = 1 if settings.arches == VARIETY else 2
    if not least:
        return list(training_arches(run_seed, count)), list(validation_arches(chosen_by, every))
    targets, tried = settings.learnt_targets(), _MOST_TRIED
    return (
        with_steep_take_off(training_arches(run_seed, tried), targets, least, count, settings.arches),
        with_steep_take_off(validation_arches(tried // 2, every), targets, least, chosen_by, settings.arches),
    )


def with_steep_take_off(
    seeds: Iterable[int], targets: Sequence[str], least_mm: float, count: int, arches: str = TEST_PHANTOM
) -> list[int]:
    """The first arches of a training that have a target set back far enough.

    They are built on the way, if they are not in the cache.

    Args:
        seeds: to choose from, in order.
        targets: of which one at least has to be set back.
        least_mm: its set-back at least.
        arches: as of `training_arch`.

    Returns:
        Their seeds.

    Raises:
        ConfigurationError: there are fewer.
    """
    from cathsim import load_phantom

    def steep(seed: int) -> bool:
        kind, own = training_arch(seed, arches)
        phantom = load_phantom(kind, seed=own, resolution=RESOLUTION)
        return max(set_back_mm(phantom, target) for target in targets) >= least_mm

    found = []
    for seed in islice(filter(steep, seeds), count):
        found.append(seed)
        if len(found) % _OFTEN == 0 or len(found) == count:
            _LOGGER.info("%d of %d arches with a target set back by %g mm: up to %d", len(found), count, least_mm, seed)
    if len(found) < count:
        raise ConfigurationError(
            f"only {len(found)} of the arches have a target set back by {least_mm:g} mm, {count} are wanted: lower "
            "stage.least_set_back_mm or the number of arches"
        )
    return found
