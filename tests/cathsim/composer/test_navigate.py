"""The dm_control composer environment: physics of one and two devices, agreement with the Gymnasium one."""

from collections.abc import Callable, Iterator
from typing import Any

import dm_env
import numpy as np
import pytest

from cathsim import Accuracy, NavigateEnv, load_guidewire
from cathsim.simulation import LEAD_ADVANCE
from tests.cathsim.makers import MakeEnv

pytest.importorskip("dm_control")

from dm_control import composer as dm_composer

from cathsim import composer

MakeComposer = Callable[..., dm_composer.Environment]
TIP = "feeder/guidewire/tip"
FORWARD = np.array([1.0, 0.0])
NUMERICS = Accuracy(timestep=0.005, refinement=1, mass_scale=10.0)
FINE = Accuracy(timestep=0.001, refinement=1, mass_scale=10.0)


@pytest.fixture(scope="module")
def make_composer() -> Iterator[MakeComposer]:
    """Makes environments of 5 ms substeps, which is quick; the default is 2.5 ms."""
    made: list[dm_composer.Environment] = []

    def make(**arguments: Any) -> dm_composer.Environment:
        made.append(composer.load(**{"seed": 0, "numerics": NUMERICS, **arguments}))
        return made[-1]

    yield make
    for env in made:
        env.close()


def episode(env: dm_composer.Environment, steps: int) -> list[dm_env.TimeStep]:
    """A start and some steps forwards with rotation."""
    actions = np.random.default_rng(0).uniform((0.5, -1), 1, (steps, 2))
    return [env.reset(), *(env.step(action) for action in actions)]


def test_straight_insertion_agrees_with_the_gymnasium_environment(
    make_composer: MakeComposer, make_env: MakeEnv
) -> None:
    other = make_env(accuracy="accurate", start_jitter=0.0, observation=("joints", "image"))
    env = make_composer(start_jitter=0.0)
    observation, _ = other.reset(seed=0)
    timestep = env.reset()
    apart, rewards, images = [], [], []
    for _ in range(60):
        timestep = env.step(FORWARD)
        observation, reward, *_ = other.step(FORWARD)
        apart.append(np.linalg.norm(timestep.observation[TIP] - other.simulation.tip))
        rewards.append(abs(timestep.reward - reward))
        images.append((timestep.observation["image"] != observation["image"]).mean())
    assert max(apart) < 3e-3
    assert max(rewards) < 3e-3
    assert np.mean(images) < 0.02, "the fluoroscope is the same"
    seen = timestep.observation
    joints = np.concatenate((seen["feeder/position"], seen["feeder/guidewire/joint_positions"]))
    assert joints.shape == (other.simulation.nq,)
    assert joints[0] == pytest.approx(other.simulation.insertion, abs=2e-4)


@pytest.mark.parametrize(
    ("catheter", "numerics", "motion"),
    [
        ("vertebral", composer.STEPPING, lambda step: [1.0, 0.0, float(step > 25), 0.0]),
        ("simmons2", FINE, lambda step: [1.0, 0.2, 1.0, 0.5]),
    ],
)
def test_two_devices_agree_with_the_gymnasium_environment(
    make_composer: MakeComposer,
    make_env: MakeEnv,
    catheter: str,
    numerics: Accuracy,
    motion: Callable[[int], list[float]],
) -> None:
    arguments = {"catheter": catheter, "start_jitter": 0.0}
    infos: list[dict[str, Any]] = []

    def reward(info: dict[str, Any]) -> float:
        infos.append(info)
        return 0.0

    other = make_env(accuracy="accurate", observation="devices", reward=reward, **arguments)
    env = make_composer(numerics=numerics, reward=reward, **arguments)
    other.reset(seed=0)
    env.reset()
    apart = []
    for step in range(50):
        action = np.array(motion(step))
        seen, observation = env.step(action).observation, other.step(action)[0]
        apart.append(np.linalg.norm(seen[TIP] - other.simulation.tip))
    assert np.median(apart) < 1e-3
    assert max(apart) < 4e-3
    assert np.allclose(seen["devices"], observation[:, :2], atol=3e-4)
    mine, theirs = infos[-2:]
    assert theirs.keys() - mine.keys() == {"feeder_forces"}
    for key in ("insertion", "rotation", "catheter_insertion", "catheter_rotation", "lead"):
        assert mine[key] == pytest.approx(theirs[key], abs=3e-4), key


def test_where_the_drive_is_stuck_the_feeders_slip(make_composer: MakeComposer) -> None:
    env = make_composer(catheter="straight", start_jitter=0.0)
    env.reset()
    for _ in range(30):
        start = env.step(np.array([1.0, 0.0, 1.0, 0.0])).observation["devices"][:, 0]
    assert start.min() > 0.05
    env.physics.bind(env.task.feeder.joints[0]).damping = 1e6  # kg/s: it withstands the servo
    moved = np.array([env.step(np.array([1.0, 0.0, 0.0, 0.0])).observation["devices"][:, 0] for _ in range(20)]) - start
    assert np.abs(moved).max() < LEAD_ADVANCE + 1e-4  # 40 mm were asked for
    assert (np.ptp(moved[1:], axis=0) < 2e-4).all()  # neither wire nor catheter, once the servo's lead is used up


def test_a_reset_really_resets_without_compiling_again_also_after_an_invalid_state(make_composer: MakeComposer) -> None:
    env = make_composer(start_jitter=0.0)
    first = episode(env, 15)
    model = env.physics.model.ptr
    again = episode(env, 15)
    assert env.physics.model.ptr is model
    for one, other in zip(first, again, strict=True):
        for name, value in one.observation.items():
            assert np.array_equal(value, other.observation[name]), name
    env.physics.data.qvel[7] = np.nan
    timestep = env.step(FORWARD)
    assert timestep.last()
    assert (timestep.reward, timestep.discount) == (0.0, 0.0)
    assert all(np.isfinite(value).all() for value in timestep.observation.values())
    assert env.step(FORWARD).first()
    assert np.isfinite(env.step(FORWARD).reward)


def test_specs_describe_what_comes_and_other_actions_are_refused(make_composer: MakeComposer) -> None:
    env = make_composer(wire="thesis", image_size=48)
    timestep = env.reset()
    spec = env.observation_spec()
    assert spec.keys() == timestep.observation.keys()
    for name, value in timestep.observation.items():
        spec[name].validate(value)
    assert timestep.observation["image"].shape == (1, 48, 48)
    assert "mask" not in spec
    assert timestep.observation["feeder/guidewire/joint_positions"].shape == (166,)
    action = env.action_spec()
    assert (action.shape, action.minimum, action.maximum) == ((2,), -1.0, 1.0)
    assert env.control_timestep() == 0.1
    with pytest.raises(ValueError, match="expected a finite action"):
        env.step(np.array([np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"expected an action of shape \(2,\), got \(3,\)"):
        env.step(np.zeros(3))


def test_reaching_the_target_ends_with_reward_ten(make_composer: MakeComposer) -> None:
    env = make_composer(success_radius=0.17, success="straight")  # a few steps from the start
    env.reset()
    timestep = env.step(FORWARD)
    while timestep.mid():
        assert timestep.reward < 0
        assert timestep.discount == 1.0
        timestep = env.step(FORWARD)
    assert (timestep.reward, timestep.discount) == (10.0, 0.0)
    assert env.step(FORWARD).first()


def test_motors_bend_the_tip(make_composer: MakeComposer) -> None:
    env, ends = make_composer(actions="tip_motors", start_jitter=0.0), []
    for share in (0.0, 1.0):
        env.reset()
        action = np.full(21, share)
        action[-1] = 1.0
        for _ in range(12):
            timestep = env.step(action)
        ends.append(timestep.observation[TIP])
    assert env.action_spec().shape == (21,)
    assert np.linalg.norm(ends[1] - ends[0]) > 3e-3


def test_a_reward_of_ones_own_is_given_what_navigate_env_gives(make_composer: MakeComposer) -> None:
    seen: list[dict[str, Any]] = []

    def reward(info: dict[str, Any]) -> float:
        seen.append(info)
        return -info["insertion"]

    env = make_composer(reward=reward)
    env.reset()
    env.step(np.array([3.0, 0.0]))
    environment = NavigateEnv("type_1", reward=reward, accuracy="fast")
    environment.reset(seed=0)
    environment.step(np.array([3.0, 0.0]))
    for one in seen:
        np.testing.assert_array_equal(one["action"], [1, 0])
    assert seen[0].keys() >= {"insertion", "rotation", "invalid", "progress", "moved"}
    assert seen[0]["insertion"] == pytest.approx(seen[1]["insertion"], abs=3e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"target": "coronary"}, "unknown target 'coronary'"),
        ({"actions": "tip"}, "unknown actions 'tip'"),
        ({"entry": "radial"}, "unknown entry 'radial'"),
        ({"numerics": "exact"}, "unknown numerics 'exact'"),
        ({"wire": load_guidewire("default").scaled(0.12)}, "the wire of 120 mm is too short"),
        ({"colour": "red"}, "no argument colour"),
        ({"catheter": "vertebral", "actions": "tip_motors"}, "without tip motors"),
    ],
    ids=str,
)
def test_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        composer.load(**arguments)


def test_visual_model_is_rendered(run_python: Callable[[str], str]) -> None:
    snippet = (
        "import os\n"
        "os.environ['MUJOCO_GL'] = 'BACKEND'\n"
        "try:\n"
        "    import mujoco\n"
        "    mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 8, 8).close()\n"
        "except Exception as error:\n"
        "    raise SystemExit(print('missing'))\n"
        "from cathsim import composer\n"
        "env = composer.load(seed=0, visual=True)\n"
        "env.reset()\n"
        "for _ in range(30): env.step([1.0, 0.3])\n"
        "red, green, blue = env.physics.render(480, 360, camera_id='frontal').reshape(-1, 3).T.astype(int)\n"
        "vessel = (red > green + 20) & (red > blue + 20)\n"
        "print('drawn', vessel.mean(), ((green < 90) & (red < 140)).sum())\n"
    )
    for backend in ("egl", "osmesa"):
        outcome, *drawn = run_python(snippet.replace("BACKEND", backend)).split()
        if outcome == "drawn":
            break
    else:
        pytest.skip("neither EGL nor OSMesa works here")
    assert 0.05 < float(drawn[0]) < 0.6, "the vessel"
    assert int(drawn[1]) > 30, "the wire"
