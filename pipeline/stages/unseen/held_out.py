"""Sets of tests of the stage `unseen`, from its settings."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.seeds import unseen_arches
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.tables import CLUTTERED, MISREGISTERED, UNSEEN
from pipeline.stages.unseen.trials import HeldOutSet

REAL_MESH = "real_mesh"

_LOGGER = logging.getLogger(__name__)


def test_sets(settings: UnseenSettings) -> tuple[HeldOutSet, ...]:
    """The tests of a policy: unseen random arches first, named phantoms, the mesh, and other wires on unseen arches.

    Returns:
        Those that there are; a mesh that is not there is left out with a warning.
    """
    unseen = tuple(unseen_arches(settings.test_anatomies))
    wire = settings.task.wire
    tests = [HeldOutSet(UNSEEN, unseen, wire=wire, modes=("deterministic", "stochastic"))]
    own: dict[str, Any] = {"wire": wire, "targets": tuple(settings.own_targets), "entry": settings.own_entry}
    for name in settings.phantoms:
        count = settings.mesh_episodes if name == settings.file_name else settings.named_episodes
        tests.append(HeldOutSet(name, (settings.anatomy(name),), count, **own))
    if settings.mesh is not None:
        if Path(settings.mesh).exists():
            tests.append(HeldOutSet(REAL_MESH, (AnatomyFile(settings.mesh),), settings.mesh_episodes, wire))
        else:
            _LOGGER.warning("there is no mesh %s: the test on a scanned anatomy is left out", settings.mesh)
    tests += [HeldOutSet(f"{UNSEEN} {kind}", unseen[: settings.wire_anatomies], wire=kind) for kind in settings.wires]
    return tuple(tests)


def cluttered(settings: UnseenSettings) -> tuple[HeldOutSet, ...]:
    """The test of the X-ray policy among clutter, on the first of the unseen arches."""
    arches = tuple(unseen_arches(settings.test_anatomies))[: settings.clutter_anatomies]
    return (
        (HeldOutSet(CLUTTERED, arches, wire=settings.task.wire, clutter=settings.clutter),) if settings.clutter else ()
    )


def misregistered(settings: UnseenSettings) -> tuple[HeldOutSet, ...]:
    """The tests of the roadmap policy with errors of the registration, on the same arches and starts as without."""
    arches = tuple(unseen_arches(settings.test_anatomies))
    return tuple(
        HeldOutSet(f"{MISREGISTERED} {noise:g} mm", arches, registration_noise=noise / 1e3)
        for noise in settings.registration_noise_mm
        if noise
    )
