"""An environment whose wire comes in at an open end or at a point in the lumen."""

import gymnasium
import numpy as np
import pytest

from cathsim import ENVIRONMENT, NavigateEnv
from cathsim.anatomy import Phantom
from cathsim.anatomy.entry import AHEAD
from cathsim.observations.fluoroscopes import SHOWN_SHEATH, shown_points


def entries(phantom: Phantom) -> dict[str, object]:
    aorta = phantom.tree.root
    return {"from the arm": "lsa_end", "amid the aorta": tuple(aorta.point_at(0.3 * aorta.length).tolist())}


@pytest.mark.parametrize("which", ["from the arm", "amid the aorta"])
def test_wire_begins_at_its_entry_and_goes_in(type_1: Phantom, which: str) -> None:
    entry = entries(type_1)[which]
    env = NavigateEnv(type_1, "bca", entry=entry, observation=("roadmap", "image"), accuracy="fast")
    gate = type_1.entry(env.simulation.entry)
    env.reset(seed=0)
    assert np.linalg.norm(env.simulation.tip - gate.position) < 3 * AHEAD  # a bent tip springs aside
    for _ in range(15):
        _, _, _, truncated, info = env.step(np.array([1.0, 0.3]))
        assert not truncated
    assert info["insertion"] > 0.02
    assert type_1.grid.sample(info["tip"]) > -1e-3
    drawn = shown_points(env.simulation)
    assert np.linalg.norm(drawn[-1] - (gate.position - SHOWN_SHEATH * gate.direction)) < 1e-9


@pytest.mark.parametrize("which", ["from the arm", "amid the aorta"])
def test_specification_and_pickle_give_the_same_environment(type_1: Phantom, which: str) -> None:
    entry = entries(type_1)[which]
    env = gymnasium.make(ENVIRONMENT, target="lcca", entry=entry, observation="tip", accuracy="fast")
    assert env.spec is not None
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.simulation.entry == env.unwrapped.simulation.entry
    for one in (env, again):
        one.reset(seed=3)
    action = np.array([0.7, -0.4])
    assert np.array_equal(env.step(action)[0], again.step(action)[0])


def test_unknown_entry_lists_those_that_there_are(type_1: Phantom) -> None:
    with pytest.raises(ValueError, match=r"unknown entry 'femoral' in phantom 'type_1'; choose from .*lsa_end"):
        NavigateEnv("type_1", entry="femoral")
    with pytest.raises(ValueError, match="lies outside the lumen of type_1"):
        NavigateEnv("type_1", entry=(0.0, 0.0, 0.9))
    with pytest.raises(ValueError, match="needs an entry at an open end"):
        NavigateEnv(type_1, entry=entries(type_1)["amid the aorta"], contact="hulls")
