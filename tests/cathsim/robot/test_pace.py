"""The pace of decisions: speeds at full action, timesteps that divide a step, messages."""

import numpy as np
import pytest

from cathsim.devices.choice import simulation_of
from cathsim.devices.shelf import load_catheter
from cathsim.environment import NavigateEnv
from cathsim.guidewire import load_guidewire
from cathsim.presets import ACCURACY, dividing
from cathsim.robot.pace import PACES, Pace


def test_a_timestep_divides_the_step_and_stays_where_it_does() -> None:
    for numerics in ACCURACY.values():
        assert dividing(numerics, 0.1) is numerics
        step = dividing(numerics, 1 / 7.5).timestep
        assert round(1 / 7.5 / step) * step == pytest.approx(1 / 7.5)
        assert step == pytest.approx(numerics.timestep, rel=0.05)


def test_full_actions_move_at_the_published_speeds(type_1) -> None:
    environment = NavigateEnv(type_1, "lcca", pace="arch_variety", observation="tip")
    environment.reset(seed=0)
    simulation, pace = environment.simulation, PACES["arch_variety"]
    environment.step(np.array([1.0, 1.0]))
    before = simulation.insertion, simulation.rotation, simulation.data.time
    for _ in range(5):
        environment.step(np.array([1.0, 1.0]))
    seconds = simulation.data.time - before[2]
    assert seconds == pytest.approx(5 / 7.5)
    assert (simulation.insertion - before[0]) / seconds == pytest.approx(0.035, rel=0.02)
    assert (simulation.rotation - before[1]) / seconds == pytest.approx(np.pi, rel=0.02)
    assert pace.interval == pytest.approx(0.1333, abs=1e-4)


def test_a_copy_with_other_numerics_keeps_the_pace(type_1) -> None:
    pace = Pace(interval=0.05, translation=1e-3)
    for catheter in (None, load_catheter("vertebral")):
        simulation = simulation_of(type_1, load_guidewire("default"), catheter, ACCURACY["accurate"], pace=pace)
        copy = simulation.stepped_by(ACCURACY["fast"])
        assert copy.pace == pace
        assert copy.substeps * copy.numerics.timestep == pytest.approx(0.05)


def test_a_pace_that_there_is_not_is_refused(type_1) -> None:
    with pytest.raises(ValueError, match="unknown pace 'slow'; there are usual, arch_variety"):
        NavigateEnv(type_1, pace="slow")
    with pytest.raises(ValueError, match=r"translation must lie in .* m, got 35"):
        Pace(translation=35)
