"""Episodes in which a force depends on the image, samples of them, and a network fitted to those."""

from dataclasses import replace

import numpy as np
import pytest

from enn.fitting import EpisodeFitSettings
from enn.force.prediction import DESK_FORCE, ForcePredictor, fit_force
from enn.force.samples import ForceSamples, force_samples
from enn.imitation.dagger import DisturbanceSettings, Disturbed, record
from enn.trajectory import Trajectory
from tests.enn.imitation.drawn_point import DrawnPoint, expert

QUICK = replace(DESK_FORCE, fit=EpisodeFitSettings(epochs=12, batch_size=32, learning_rate=3e-3, validation_share=0.0))


@pytest.fixture(scope="module")
def episodes() -> list[Trajectory]:
    size = DisturbanceSettings(noise=0.4, spell_chance=0.3)
    steers = [Disturbed(expert, np.random.default_rng(k), size) for k in range(50)]
    return [record(DrawnPoint(), one, seed=k, keys=("image", "place")) for k, one in enumerate(steers)]


@pytest.fixture(scope="module")
def halves(episodes: list[Trajectory]) -> tuple[ForceSamples, ForceSamples]:
    features = [episode.observations["place"] for episode in episodes]
    return force_samples(episodes[:40], features=features[:40]), force_samples(episodes[40:])


@pytest.fixture(scope="module")
def predictor(halves: tuple[ForceSamples, ForceSamples]) -> ForcePredictor:
    return fit_force(halves[0], QUICK)[0]
