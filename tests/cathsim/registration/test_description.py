"""Specifications of environments as JSON, and environments made of them."""

import dataclasses
import json
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from cathsim import ACCURACY, ENVIRONMENT, NavigateEnv, NavigationTask, Phantom, load_guidewire, load_phantom
from cathsim.anatomy import ArchParameters
from cathsim.anatomy.generator.arch_parameters import Aneurysm
from cathsim.blood.flow import BloodFlow
from cathsim.fluoroscopy import BiplaneFluoroscope
from cathsim.fluoroscopy.scene import SCENES
from cathsim.registration import MANY
from cathsim.registration.description import from_spec, to_spec
from tests.cathsim.equal_observations import same

COARSE = 2e-3


class Penny(NavigationTask):
    """A reward of its own."""

    def step_reward(self, distance: float, progress: float, *_: float, success: bool) -> float:
        return 0.01


def penny(info: dict[str, Any]) -> float:
    """A reward of its own, as a function."""
    return 0.01 + float(info["progress"])


@pytest.fixture(scope="module")
def own_arch() -> Phantom:
    measures = ArchParameters(apex_ratio=1.1, aneurysm=Aneurysm("fusiform", distance=0.05, length=0.07, bulge=0.008))
    return load_phantom("mine", parameters=measures, resolution=COARSE)


def made_again(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    text = env.spec.to_json()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    return gymnasium.make(EnvSpec.from_json(text))


def play_alike(one: gymnasium.Env[Any, Any], other: gymnasium.Env[Any, Any], steps: int = 8) -> None:
    drawn = np.random.default_rng(0).uniform(-0.2, 1, (steps, *one.action_space.shape)).astype(np.float32)
    assert same(one.reset(seed=5), other.reset(seed=5))
    for action in drawn:
        assert same(one.step(action), other.step(action))


@pytest.mark.parametrize(
    "arguments",
    [
        {"phantom": "random", "phantom_seed": 1, "target": (0.0, 0.0, 0.0)},
        {"wire": load_guidewire("default", friction=0.1).scaled(0.31), "accuracy": ACCURACY["fast"]},
        {"task": Penny(target="lcca", max_steps=40), "success_radius": np.float64(0.005)},
        {"task": NavigationTask(reward=penny), "drive": "robot", "start_rotation": np.pi, "actions": "feeder"},
        {"blood": BloodFlow(peak_velocity=0.3, shares={"lcca": 0.1}), "observation": ("joints", "force")},
    ],
    ids=["random arch, point", "own wire", "own task", "task of a function, robot", "blood"],
)
def test_an_environment_is_made_again_from_json(arguments: dict[str, Any]) -> None:
    arguments = dict(arguments)
    if "target" in arguments:
        place = load_phantom("random", seed=1).target("bca").position
        arguments["target"] = place
    env = gymnasium.make(ENVIRONMENT, **{"accuracy": "fast", **arguments})
    again = made_again(env)
    play_alike(env, again)
    assert isinstance(again.unwrapped, NavigateEnv)
    assert isinstance(env.unwrapped, NavigateEnv)
    assert again.unwrapped.task == env.unwrapped.task
    assert type(again.unwrapped.task) is type(env.unwrapped.task)
    assert again.unwrapped.simulation.wire == env.unwrapped.simulation.wire


def test_a_function_without_a_place_is_refused() -> None:
    with pytest.raises(ValueError, match=r"function .*<lambda> cannot be written as JSON"):
        to_spec(lambda info: 0.0)
    for name in ("math:nothing", "cathsim:ENVIRONMENT", "math"):
        with pytest.raises(ValueError, match=f"there is no function '{name}'"):
            from_spec({"class": "function", "name": name})


def test_cameras_are_described(type_1: Phantom) -> None:
    for surroundings in ("patient", SCENES["bath"].filled("contrast")):
        cameras = BiplaneFluoroscope.of(type_1, "clinical", size=40, surroundings=surroundings)
        seen = ("image_a", "mask_b")
        env = gymnasium.make(ENVIRONMENT, phantom=type_1, cameras=cameras, observation=seen, accuracy="fast")
        play_alike(env, made_again(env), steps=3)
    own = BiplaneFluoroscope(tuple(cameras.cameras.values()), tuple(cameras._stills.values()))
    env = gymnasium.make(ENVIRONMENT, phantom=type_1, cameras=own, accuracy="fast")
    with pytest.raises(ValueError, match=r"make it with BiplaneFluoroscope.of"):
        env.spec.to_json()


def test_many_anatomies_and_vectors_are_described(type_1: Phantom, own_arch: Phantom) -> None:
    arguments: dict[str, Any] = {
        "phantoms": (type_1, "type_2", 3, ("random_wide", 1), own_arch),
        "targets": ("bca", type_1.target("lcca").position),
        "wires": ("default", load_guidewire("default", friction=0.05)),
        "resolution": COARSE,
        "observation": ("roadmap",),
        "accuracy": "fast",
    }
    env = gymnasium.make(MANY, **arguments)
    again = made_again(env)
    for case in (0, 3, 4, 8, 16):
        one, other = env.reset(seed=0, options={"case": case}), again.reset(seed=0, options={"case": case})
        assert np.array_equal(one[0]["roadmap"], other[0]["roadmap"])
        assert one[1]["phantom"] == other[1]["phantom"]
    assert made_again(gymnasium.make(MANY, **{**arguments, "phantoms": range(2)})).unwrapped.phantoms == (0, 1)
    vector = gymnasium.make_vec(ENVIRONMENT, 2, phantom=own_arch, accuracy="fast")
    twin = gymnasium.make_vec(EnvSpec.from_json(vector.spec.to_json()))
    assert twin.num_envs == 2
    assert np.array_equal(vector.reset(seed=0)[0], twin.reset(seed=0)[0])
    vector.close()
    twin.close()


def test_wrappers_stay_in_the_specification(own_arch: Phantom) -> None:
    env = gymnasium.wrappers.RescaleAction(
        gymnasium.make(ENVIRONMENT, phantom=own_arch, accuracy="fast"), np.float32(0.0), np.float32(1.0)
    )
    again = made_again(env)
    assert isinstance(again, gymnasium.wrappers.RescaleAction)
    play_alike(env, again, steps=2)


def test_what_cannot_be_described_is_refused(bend: Phantom) -> None:
    with pytest.raises(ValueError, match="phantom 'bend' was put together by hand"):
        to_spec(bend)

    @dataclasses.dataclass(frozen=True)
    class Local(NavigationTask):
        pass

    with pytest.raises(ValueError, match="a Local cannot be written as JSON"):
        to_spec(Local())
    for value in ({"class": "os:system"}, {"class": "nowhere:Nothing"}, {"class": "json"}):
        with pytest.raises(ValueError, match="there is no settings class"):
            from_spec(value)
    with pytest.raises(ValueError, match=r"Guidewire has no colour|cannot be made of"):
        from_spec({"class": "cathsim.guidewire:Guidewire", "colour": "red"})
