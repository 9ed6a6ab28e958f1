"""Environments in a process of their own: the same as here, what goes wrong there, and that it ends."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from enn.reinforcement.sampling import NotFiniteError
from enn.reinforcement.start_state_buffer import StartStateBuffer
from enn.reinforcement.vector_envs import POSSIBLE, SampledEnvs, SubprocessEnvs

pytestmark = pytest.mark.skipif(not POSSIBLE, reason="open files cannot be handed over to a process here")

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (12, 4, 2))


def _buffer() -> StartStateBuffer:
    buffer = StartStateBuffer(share=0.5, seed=1)
    buffer.add_episode(np.array([[0.2, 0.1], [0.1, 0.3]]))
    return buffer


def _played(envs: SampledEnvs | SubprocessEnvs, actions: np.ndarray) -> list[tuple[Any, ...]]:
    moments = []
    for action in actions:
        observations, rewards, dones, infos = envs.step(action)
        assert isinstance(observations, dict)
        moments.append((observations["place"].tolist(), rewards.tolist(), dones.tolist(), infos))
    return moments


def _without_arrays(moments: list[tuple[Any, ...]]) -> list[Any]:
    return [(*moment[:3], [repr(sorted(info.items())) for info in moment[3]]) for moment in moments]


def test_it_gives_what_the_environments_would_here_and_goes_on_from_a_state(point_env: Any) -> None:
    given: dict[str, Any] = {"factories": [lambda: point_env(max_steps=5)] * 4, "seed": 3, "action_repeat": 2}
    here = SampledEnvs(**given, start_state_buffer=_buffer(), keys=("place",))
    apart = SubprocessEnvs(**given, start_state_buffer=_buffer(), keys=("place",), threads=2)
    with contextlib.closing(here), contextlib.closing(apart):
        assert apart.observation_space == here.observation_space
        assert apart.action_space == here.action_space
        np.testing.assert_array_equal(apart.reset()["place"], here.reset()["place"])  # type: ignore[index,call-overload]
        assert _without_arrays(_played(apart, ACTIONS[:6])) == _without_arrays(_played(here, ACTIONS[:6]))
        state = apart.state()
        expected = _without_arrays(_played(here, ACTIONS[6:]))
        assert _without_arrays(_played(apart, ACTIONS[6:])) == expected
        apart.restore(state)
        assert _without_arrays(_played(apart, ACTIONS[6:])) == expected
        assert apart.cpu_s > 0
        assert apart.get_attr("max_steps") == [5] * 4
        apart.set_attr("max_steps", 7, [1])
        assert apart.get_attr("max_steps") == [5, 7, 5, 5]
        assert len(apart.env_method("start_state", indices=[0, 2])) == 2


class UnmakeableError(Exception):
    """Can be sent, but not made again from its arguments."""

    def __init__(self, what: str, *, where: str) -> None:
        super().__init__(what)


def test_what_goes_wrong_there_is_raised_here_and_what_cannot_be_sent_is_one_clear_sentence(point_env: Any) -> None:
    class UnsendableError(Exception):
        pass

    class Broken(point_env):  # type: ignore[misc]
        def step(self, action: Any) -> Any:
            if action[0] > 0:
                raise UnmakeableError("stuck", where="here")
            if action[0] < 0:
                raise UnsendableError("torn")
            observation, _, *rest = super().step(action)
            return observation, float("nan"), *rest

    with contextlib.closing(SubprocessEnvs([Broken] * 2, seed=0)) as envs:
        envs.reset()
        with pytest.raises(NotFiniteError, match="the reward of environment 0 is not finite"):
            envs.step(np.array([[0.0, 0.0]] * 2))
        with pytest.raises(AttributeError, match="no_such_thing"):
            envs.get_attr("no_such_thing")
        with pytest.raises(RuntimeError, match=r"cannot be sent between processes \(.*where.*\): use threads=1"):
            envs.step(np.array([[0.5, 0.0]] * 2))
        with pytest.raises(RuntimeError, match="UnsendableError: torn"):
            envs.step(np.array([[-0.5, 0.0]] * 2))
        assert envs.get_attr("render_mode") == [None] * 2
        os.kill(envs._process.pid, signal.SIGKILL)
        os.waitid(os.P_PID, envs._process.pid, os.WEXITED | os.WNOWAIT)
        with pytest.raises(RuntimeError, match=r"process that steps the environments has ended \(code -9\).*threads=1"):
            envs.step(ACTIONS[0, :2])


def test_environments_that_cannot_be_made_say_why(point_env: Any) -> None:
    made = []

    def factory() -> Any:
        if os.getpid() != made[0]:
            raise ValueError("there is no such vessel")
        return point_env()

    made.append(os.getpid())
    with (
        contextlib.closing(SubprocessEnvs([factory], seed=0)) as envs,
        pytest.raises(ValueError, match="no such vessel"),
    ):
        envs.reset()


def test_it_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    program = (
        "import os, gymnasium\n"
        "from enn.reinforcement.vector_envs import SubprocessEnvs\n"
        "envs = SubprocessEnvs([lambda: gymnasium.make('CartPole-v1')], seed=0)\n"
        "envs.reset()\n"
        f"open({str(tmp_path / 'pid')!r}, 'w').write(str(envs._process.pid))\n"
        "os._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
    process = int((tmp_path / "pid").read_text())
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("the environments' process has outlived its starter")
