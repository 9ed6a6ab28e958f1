"""Phantoms shared by the anatomy tests, built once into a cache of the test run."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Branch, Phantom, VesselTree, load_phantom


@pytest.fixture(scope="module", autouse=True)
def no_pictures() -> Iterator[None]:
    """Imports draw no picture of what is unsure, which takes a second; tests of pictures draw them directly."""

    def draw(phantom: Phantom, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cathsim.anatomy.pictures.import_picture.draw_import", draw)
        yield


@pytest.fixture(scope="session")
def cache(anatomy_cache: Path) -> Path:
    return anatomy_cache


@pytest.fixture(scope="session")
def phantom(cache: Path) -> Phantom:
    return load_phantom("type_1", cache_dir=cache)


@pytest.fixture(scope="session")
def tube() -> VesselTree:
    """A straight vessel along z, 60 mm long, of 6 mm radius."""
    z = np.linspace(-0.03, 0.03, 61)
    points = np.stack([0 * z, 0 * z, z], axis=1)
    return VesselTree((Branch("aorta", points, np.full(61, 0.006)),))


@pytest.fixture(scope="session")
def tee() -> VesselTree:
    """A straight vessel along z with a side branch along x from its middle."""
    z = np.linspace(-0.04, 0.04, 81)
    x = np.linspace(0, 0.04, 41)
    main = Branch("aorta", np.stack([0 * z, 0 * z, z], axis=1), np.full(81, 0.008))
    side = Branch("bca", np.stack([x, 0 * x, 0 * x], axis=1), np.full(41, 0.004), "aorta", 0.04)
    return VesselTree((main, side))
