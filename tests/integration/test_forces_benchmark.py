"""Episodes of the benchmark of forces: devices of trained policies, draws that are seeded, a flow."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.forces.episodes import Case
from benchmarks.forces.operators import WIRE, TrainedOperator


@pytest.mark.parametrize(
    ("source", "device", "fits"),
    [
        ("generalist", WIRE, True),
        ("generalist", "jb2", False),
        ("generalist_jb2", "jb2", True),
        ("generalist_jb2", "simmons2", False),
        ("generalist_jb2", WIRE, False),
    ],
)
def test_a_policy_steers_the_devices_that_it_was_trained_with(source: str, device: str, fits: bool) -> None:
    operator = TrainedOperator(source)
    assert operator.name == "policy"
    assert operator.fits(Case(device, 0.06, operator.name, "bca", 0)) == fits


def test_the_flow_of_a_case_drags_its_devices() -> None:
    tips = []
    for blood in (None, "pulsatile"):
        environment = Case(WIRE, 0.06, "random", "bca", 0, blood).environment(accuracy="fast")
        environment.reset(seed=0)
        for _ in range(12):
            *_, info = environment.step(np.array([1.0, 0.0]))
        tips.append(np.asarray(info["tip"]))
        environment.close()
    assert 1e-6 < np.linalg.norm(tips[1] - tips[0]) < 5e-3  # m


def test_the_same_generator_draws_the_same_motions() -> None:
    operator = TrainedOperator("generalist_jb2")
    case = Case("jb2", 0.06, operator.name, "bca", 0)
    environment = case.environment(operator.observation, accuracy="fast")

    def motions(seed: int) -> np.ndarray:
        act = operator(environment, np.random.default_rng(seed))
        observation, _ = environment.reset(seed=0)
        chosen = []
        for _ in range(9):
            chosen.append(act(observation))
            observation, *_ = environment.step(chosen[-1])
        return np.array(chosen)

    first = motions(3)
    assert first.shape == (9, 4)
    assert np.abs(first).max() <= 1
    np.testing.assert_array_equal(motions(3), first)
    assert np.abs(motions(4) - first).max() > 1e-3
    environment.close()
