"""The dm_control composer environment: physics, agreement with the Gymnasium one, and the workaround it stands on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import dm_env
import numpy as np
import pytest

from cathsim import GUIDEWIRES, Accuracy, NavigateEnv, Phantom
from cathsim.contact.sdf import MAGIC
from cathsim.devices.arena import model_spec
from cathsim.simulation import vessel_of

pytest.importorskip("dm_control")

from dm_control import composer as dm_composer

from cathsim import composer

MakeEnv = Callable[..., NavigateEnv]
MakeComposer = Callable[..., dm_composer.Environment]
TIP = "feeder/guidewire/tip"
FORWARD = np.array([1.0, 0.0])
NUMERICS = Accuracy(timestep=0.005, refinement=1, mass_scale=10.0)


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


def test_thirty_steps_forward_touch_the_vessel_and_stay_finite(type_1: Phantom) -> None:
    env = composer.load(seed=0)  # at the default timestep
    assert env.physics.timestep() == 0.0025
    timestep = env.reset()
    assert timestep.first()
    start = timestep.observation[TIP]
    forces, points = [], []
    for _ in range(30):
        timestep = env.step(FORWARD)
        for name, value in timestep.observation.items():
            assert np.isfinite(value).all(), name
        assert timestep.mid()
        forces.append(np.linalg.norm(timestep.observation["force"]))
        points.append(env.task.arena.contacts(env.physics).points)
    assert np.linalg.norm(timestep.observation[TIP] - start) > 0.05
    assert max(forces) > 1e-3
    # the dummy boxes are 20 m wide: contacts on the lumen's wall can only come from the grid
    touched = np.concatenate(points)
    assert len(touched) > 0
    assert np.abs(type_1.grid.sample(touched)).max() < 1.5e-3
    env.close()


@pytest.mark.parametrize("actions", ["feeder", "tip_motors"])
def test_model_is_that_of_the_simulator_in_three_entities(
    make_composer: MakeComposer, type_1: Phantom, actions: str
) -> None:
    env = make_composer(actions=actions)
    task, wire = env.task, GUIDEWIRES["default"]
    vessel = vessel_of(type_1, "descending")
    expected = model_spec(vessel, wire, NUMERICS, tip_motors=actions == "tip_motors").compile()
    names = [type(entity).__name__ for entity in task.root_entity.iter_entities()]
    assert names == ["VesselArena", "Feeder", "GuidewireEntity"]
    assert task.arena.vessel is vessel
    model = env.physics.model
    assert model.geom_user[0].tolist() == [MAGIC, vessel.number, 0]
    for field in [
        *("jnt_stiffness", "jnt_type", "jnt_axis", "qpos_spring", "dof_damping", "dof_armature"),
        *("geom_size", "geom_user", "geom_friction", "geom_solref", "geom_solimp", "geom_condim", "geom_priority"),
        *("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "actuator_ctrlrange"),
    ]:
        assert getattr(model, field) == pytest.approx(getattr(expected, field), rel=1e-5, abs=1e-9), field
    for option in ("integrator", "solver", "cone", "jacobian", "disableflags", "tolerance", "timestep"):
        assert getattr(model.opt, option) == getattr(expected.opt, option), option
    assert model.body_mass.sum() == pytest.approx(expected.body_mass.sum())
    nodes = task.guidewire.nodes(env.physics)
    assert np.linalg.norm(np.diff(nodes, axis=0), axis=1) == pytest.approx(wire.links[::-1], abs=1e-6)


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


def test_observations_are_of_the_state_that_the_step_has_reached(make_composer: MakeComposer) -> None:
    env = make_composer()
    timestep = episode(env, 10)[-1]
    env.physics.forward()
    assert np.array_equal(env.physics.bind(env.task.guidewire.tip_site).xpos, timestep.observation[TIP])


def test_same_seed_same_trajectory(make_composer: MakeComposer) -> None:
    runs = [episode(make_composer(seed=seed, start_rotation=1.0), 20) for seed in (3, 3, 4)]
    for one, other in zip(runs[0], runs[1], strict=True):
        assert one.reward == other.reward
        for name, value in one.observation.items():
            assert np.array_equal(value, other.observation[name]), name
    assert not np.array_equal(runs[0][0].observation[TIP], runs[2][0].observation[TIP])


def test_a_reset_really_resets_without_compiling_again(make_composer: MakeComposer) -> None:
    env = make_composer(start_jitter=0.0)
    first = episode(env, 15)
    model = env.physics.model.ptr
    again = episode(env, 15)
    assert env.physics.model.ptr is model
    for one, other in zip(first, again, strict=True):
        for name, value in one.observation.items():
            assert np.array_equal(value, other.observation[name]), name


def test_specs_describe_what_comes(make_composer: MakeComposer) -> None:
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


def test_the_mask_can_be_switched_on(make_composer: MakeComposer) -> None:
    env = make_composer()
    env.task.task_observables["mask"].enabled = True
    mask = env.reset().observation["mask"]
    assert set(np.unique(mask)) == {0, 255}


def test_reaching_the_target_ends_with_reward_ten(make_composer: MakeComposer) -> None:
    env = make_composer(
        success_radius=0.17, success="straight"
    )  # from the start the target is nearer than that after a few steps
    env.reset()
    timestep = env.step(FORWARD)
    while timestep.mid():
        assert timestep.reward < 0
        assert timestep.discount == 1.0
        timestep = env.step(FORWARD)
    assert (timestep.reward, timestep.discount) == (10.0, 0.0)
    assert env.step(FORWARD).first()


def test_a_function_gives_the_reward(make_composer: MakeComposer) -> None:
    env = make_composer(reward=lambda info: info["moved"] - 0.5 * info["action"][0])
    start = env.reset().observation[TIP]
    timestep = env.step(FORWARD)
    moved = np.linalg.norm(timestep.observation[TIP] - start)
    assert timestep.reward == pytest.approx(moved - 0.5, abs=1e-9)


def test_running_out_of_steps_truncates(make_composer: MakeComposer, type_1: Phantom) -> None:
    env = make_composer(max_steps=3, reward="geodesic")
    env.reset()
    env.step(FORWARD)
    start = env.reset().observation[TIP]  # counts from zero
    timesteps = [env.step(FORWARD) for _ in range(3)]
    assert [timestep.last() for timestep in timesteps] == [False, False, True]
    assert timesteps[-1].discount == 1.0
    gained = -np.diff(type_1.geodesic_distance([start, timesteps[-1].observation[TIP]], "bca"))[0]
    assert gained > 1e-3
    assert sum(timestep.reward for timestep in timesteps) == pytest.approx(100 * gained - 0.06, abs=1e-9)


def test_motors_bend_the_tip(make_composer: MakeComposer) -> None:
    ends = []
    for share in (0.0, 1.0):
        env = make_composer(actions="tip_motors", start_jitter=0.0)
        env.reset()
        action = np.full(21, share)
        action[-1] = 1.0
        for _ in range(12):
            timestep = env.step(action)
        ends.append(timestep.observation[TIP])
    assert env.action_spec().shape == (21,)
    assert np.linalg.norm(ends[1] - ends[0]) > 3e-3


def test_an_invalid_state_ends_the_episode(make_composer: MakeComposer) -> None:
    env = make_composer()
    env.reset()
    env.physics.data.qvel[7] = np.nan
    timestep = env.step(FORWARD)
    assert timestep.last()
    assert (timestep.reward, timestep.discount) == (0.0, 0.0)
    assert all(np.isfinite(value).all() for value in timestep.observation.values())
    assert env.step(FORWARD).first()
    assert np.isfinite(env.step(FORWARD).reward)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"phantom": "aorta"}, "unknown phantom 'aorta'"),
        ({"target": "coronary"}, "unknown target 'coronary'"),
        ({"wire": "steel"}, "unknown guidewire 'steel'"),
        ({"actions": "tip"}, "unknown actions 'tip'; there are feeder, tip_motors"),
        ({"entry": "radial"}, "unknown entry 'radial'"),
        ({"colour": "red"}, "the environment has no argument colour"),
    ],
    ids=str,
)
def test_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        composer.load(**arguments)


def test_bad_actions(make_composer: MakeComposer) -> None:
    env = make_composer()
    env.reset()
    with pytest.raises(ValueError, match="expected a finite action"):
        env.step(np.array([np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"expected an action of shape \(2,\), got \(3,\)"):
        env.step(np.zeros(3))


def test_what_is_there_to_be_seen_changes_nothing(make_composer: MakeComposer) -> None:
    plain, visual = make_composer(), make_composer(visual=True)
    for one, other in zip(episode(plain, 25), episode(visual, 25), strict=True):
        for name, value in one.observation.items():
            assert np.array_equal(value, other.observation[name]), name
    assert visual.physics.model.nmesh == 1


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


def test_without_dm_control_one_sentence_says_what_to_install(run_python: Callable[[str], str]) -> None:
    snippet = (
        "import sys\n"
        "sys.modules['dm_control'] = None\n"
        "import cathsim\n"
        "try:\n"
        "    import cathsim.composer\n"
        "except ImportError as error:\n"
        "    print(error)\n"
    )
    expected = 'cathsim.composer needs dm_control: install it with pip install "endonav-cathsim[composer]"'
    assert run_python(snippet).strip() == expected
