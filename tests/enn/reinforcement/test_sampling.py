"""Sampling: restores, encoded environments; start-state buffers, also of each case, more episodes where they fail."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from enn.encoder import EncodedEnvs
from enn.reinforcement.sampling import RECORD_EVERY, NotFiniteError
from enn.reinforcement.start_state_buffer import CaseStartStateBuffer, StartStateBuffer
from enn.reinforcement.vector_envs import SampledEnvs
from tests.enn.rod import Rod, fitted


def _play(envs: SampledEnvs, count: int) -> None:
    generator = np.random.default_rng(0)
    for _ in range(count):
        envs.step(generator.uniform(-1, 1, (envs.num_envs, 2)))


def test_action_repeat_adds_rewards_and_stops_at_the_end(point_env: Any) -> None:
    single, held = (SampledEnvs([lambda: point_env(max_steps=10)], seed=1, action_repeat=n) for n in (1, 4))
    single.reset()
    held.reset()
    action = np.array([[0.3, -0.2]])
    steps = [single.step(action) for _ in range(4)]
    observation, reward, _, infos = held.step(action)
    assert infos[0]["steps"] == 4
    assert reward[0] == pytest.approx(sum(float(step[1][0]) for step in steps), abs=1e-6)
    np.testing.assert_array_equal(observation["place"], steps[-1][0]["place"])
    held.step(action)
    _, _, dones, infos = held.step(action)
    assert dones[0]
    assert infos[0]["steps"] == 2
    assert infos[0]["episode"]["l"] == 10


def test_successes_enter_the_buffer_and_episodes_start_there(point_env: Any) -> None:
    buffer = StartStateBuffer(share=1.0, seed=0)
    envs = SampledEnvs([lambda: point_env(max_steps=100)], seed=4, start_state_buffer=buffer)
    place = envs.reset()["place"]
    start, visited, ended = place[0].copy(), [place[0].copy()], False
    while not ended:
        place, _, dones, infos = envs.step(-0.3 * np.sign(place["place"] if isinstance(place, dict) else place))
        ended = bool(dones[0])
        visited.append(infos[0]["terminal_observation"]["place"] if ended else place["place"][0].copy())
    assert infos[0]["episode"] | {"r": 0, "l": 0} == {"r": 0, "l": 0, "success": True, "fresh": True}
    kept = buffer.state()["states"]
    np.testing.assert_allclose(kept[0], start, atol=1e-6)
    np.testing.assert_allclose(kept, visited[: len(visited) - 1 : RECORD_EVERY], atol=1e-6)
    assert any(np.allclose(place["place"][0], state) for state in kept)
    for _ in range(200):
        _, _, dones, infos = envs.step(np.ones((1, 2)))
        if dones[0]:
            break
    assert infos[0]["episode"]["fresh"] is False
    assert len(buffer) == len(kept)  # a failure leaves nothing


def test_episodes_go_where_they_fail(point_env: Any) -> None:
    asked = []

    class Cases(point_env):  # type: ignore[misc]
        def reset(
            self, *, seed: int | None = None, options: dict[str, Any] | None = None
        ) -> tuple[Any, dict[str, Any]]:
            self.case = options["case"]  # type: ignore[index]
            asked.append(self.case)
            return super().reset(seed=seed)

        def start_state(self) -> np.ndarray:
            return np.append(self.place, float(self.case))

        def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            observation, reward, _, truncated, info = super().step(action)
            won = self.case == 0 and self.steps == 2
            return observation, reward, won, truncated and not won, info | {"case": self.case, "success": won}

    buffer = CaseStartStateBuffer(2, share=0.0, seed=0)
    envs = SampledEnvs([lambda: Cases(max_steps=4)] * 2, seed=0, start_state_buffer=buffer)
    envs.reset()
    _play(envs, 400)
    assert 0.1 < asked.count(0) / len(asked) < 0.25  # 0.15 of 1.3
    assert len(buffer) > 0  # the successes of case 0 alone
    assert {float(state[-1]) for state in buffer.state()["cases"][0]["states"]} == {0.0}


def test_what_is_not_finite_stops_with_one_sentence(point_env: Any) -> None:
    envs = SampledEnvs([point_env, lambda: point_env(broken_at=3)], seed=0)
    envs.reset()
    with pytest.raises(NotFiniteError, match="observation 'place' of environment 1 is not finite after 6 decisions"):
        _play(envs, 5)


def test_refusals_say_why(point_env: Any) -> None:
    with pytest.raises(ValueError, match="at least one environment factory"):
        SampledEnvs([], seed=0)
    with pytest.raises(ValueError, match="action_repeat must be at least 1, got 0"):
        SampledEnvs([point_env], seed=0, action_repeat=0)
    with pytest.raises(ValueError, match="same observation and action spaces"):
        SampledEnvs([point_env, lambda: point_env(("range",))], seed=0)

    class Rootless(point_env):  # type: ignore[misc]
        start_state = property()

    with pytest.raises(ValueError, match=r"cannot start from a start-state buffer.*start_state_buffer_share=0"):
        SampledEnvs([Rootless], seed=0, start_state_buffer=StartStateBuffer())
    envs = SampledEnvs([point_env], seed=0)
    envs.reset()
    with pytest.raises(ValueError, match="has 1 environments, this one 2"):
        SampledEnvs([point_env] * 2, seed=0).restore(envs.state())


def test_encoded_environments_give_features_at_every_moment() -> None:
    encoder, _ = fitted("image", "mask")
    envs = EncodedEnvs(DummyVecEnv([Rod, Rod]), encoder)
    plain = DummyVecEnv([Rod, Rod])
    assert set(envs.observation_space.spaces) == {"features"}  # type: ignore[attr-defined]
    observations, raw = envs.reset(), plain.reset()
    generator = np.random.default_rng(0)
    ends = 0
    for _ in range(31):
        assert observations["features"].shape == (2, 12)
        assert np.allclose(observations["features"], envs.encode(raw)["features"], atol=1e-5)  # type: ignore[arg-type]
        actions = generator.uniform(-1, 1, (2, 2)).astype(np.float32)
        observations, _, dones, infos = envs.step(actions)  # type: ignore[assignment]
        raw, _, _, plain_infos = plain.step(actions)
        for index in np.flatnonzero(dones):
            ends += 1
            last = {key: value[None] for key, value in plain_infos[index]["terminal_observation"].items()}
            expected = envs.encode(last)["features"][0]
            assert set(infos[index]["terminal_observation"]) == {"features"}
            assert np.allclose(infos[index]["terminal_observation"]["features"], expected, atol=1e-5)
    assert ends == 2


def test_wrappers_are_kept_and_go_on_counting_after_a_restore(point_env: Any) -> None:
    def wrapped() -> gymnasium.Env[Any, Any]:
        ordered = gymnasium.wrappers.OrderEnforcing(point_env(("place", "range")))
        return gymnasium.wrappers.TimeLimit(gymnasium.wrappers.FlattenObservation(ordered), 5)

    envs, other = SampledEnvs([wrapped] * 2, seed=3), SampledEnvs([wrapped] * 2, seed=3)
    envs.reset()
    for _ in range(3):
        expected = envs.step(np.zeros((2, 2)))[0]
    np.testing.assert_array_equal(other.restore(envs.state()), expected)
    for _ in range(4):
        for one, two in zip(envs.step(np.ones((2, 2)))[:3], other.step(np.ones((2, 2)))[:3], strict=True):
            np.testing.assert_array_equal(one, two)


def test_environments_without_state_start_new_episodes(point_env: Any, caplog: pytest.LogCaptureFixture) -> None:
    class Forgetful(point_env):  # type: ignore[misc]
        state = restore = property()

    envs = SampledEnvs([Forgetful] * 2, seed=0)
    envs.reset()
    envs.step(np.zeros((2, 2)))
    observations, again = (SampledEnvs([Forgetful] * 2, seed=0).restore(envs.state()) for _ in range(2))
    assert observations["place"].shape == (2, 2)
    np.testing.assert_array_equal(observations["place"], again["place"])
    assert "they start new episodes" in caplog.text


def test_draws_its_share_from_what_was_added() -> None:
    buffer = StartStateBuffer(share=0.25, seed=3)
    assert buffer.draw() is None
    states = np.arange(20.0).reshape(10, 2)
    buffer.add_episode(states)
    draws = [buffer.draw() for _ in range(4000)]
    given = [draw for draw in draws if draw is not None]
    assert 0.22 < len(given) / len(draws) < 0.28
    assert {tuple(draw) for draw in given} == {tuple(row) for row in states}


def episode(case: int, count: int, value: float = 0.0) -> np.ndarray:
    return np.column_stack((np.full(count, value), np.arange(count), np.full(count, case)))


def test_a_rare_case_is_drawn_as_often_as_a_frequent_one() -> None:
    buffer = CaseStartStateBuffer(3, share=1.0, capacity=20)
    buffer.add_episode(episode(2, 4))
    for _ in range(30):
        buffer.add_episode(episode(0, 10))
    assert len(buffer) == 24  # the frequent one has not crowded the rare one out
    cases = np.array([buffer.draw()[-1] for _ in range(2000)])  # type: ignore[index]
    assert set(cases) == {0.0, 2.0}
    assert 0.45 < (cases == 2).mean() < 0.55


def test_states_of_cases_are_drawn_by_the_seed_and_apart_from_each_other() -> None:
    def drawn(seed: int) -> dict[int, list[float]]:
        buffer = CaseStartStateBuffer(2, share=1.0, capacity=50, seed=seed)
        for case in (0, 1):
            buffer.add_episode(episode(case, 50))
        found: dict[int, list[float]] = {0: [], 1: []}
        for _ in range(60):
            state = buffer.draw()
            assert state is not None
            found[int(state[-1])].append(float(state[1]))
        return {case: places[:20] for case, places in found.items()}

    first, second = drawn(0), drawn(1)
    assert first == drawn(0)
    assert first[0] != second[0]
    assert first[0] != first[1]


def test_a_buffer_goes_on_exactly_after_a_restore() -> None:
    buffer, other = CaseStartStateBuffer(3, seed=1, capacity=5), CaseStartStateBuffer(3, seed=9, capacity=5)
    buffer.add_episode(episode(1, 7))
    buffer.record_outcome(1, success=True)
    buffer.choose_case()
    other.restore(buffer.state())
    for one in (buffer, other):
        one.add_episode(episode(2, 3, value=4.0))
        one.record_outcome(0, success=True)
    for _ in range(50):
        assert buffer.choose_case() == other.choose_case()
        first, second = buffer.draw(), other.draw()
        assert (first is None) == (second is None)
        if first is not None:
            np.testing.assert_array_equal(first, second)
