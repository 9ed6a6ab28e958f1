"""Rehearsal over the cases of a toy environment: it learns, starts from a policy, plays every case."""

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest

from enn.policy import Policy
from enn.reinforcement.rehearsal import (
    DEMONSTRATION_FIRST,
    DEMONSTRATION_SHARE,
    DEMONSTRATION_SLOWER,
    demonstrated,
    first_evaluation,
    play_cases,
    rehearse,
)
from enn.reinforcement.training.settings import TrainingSettings
from enn.reinforcement.training.training import Training
from tests.enn.conftest import PointEnv
from tests.enn.reinforcement.small_training import SMALL

FROM_NOTHING = dataclasses.replace(
    SMALL, keys=("place",), gradient_steps=1.0, start_state_buffer_share=0.5, keep_critics=True
)


class WindyEnv(PointEnv):
    """The point drifts by what its case says."""

    cases = 3

    def __init__(self) -> None:
        super().__init__()
        self.case, self.wind = 0, np.zeros(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        options = dict(options or {})
        start = options.get("start")
        self.case = int(start[-1] if start is not None else options.get("case", 0))
        self.wind = np.array([(0.0, 0.0), (0.01, 0.0), (0.0, 0.01)][self.case])
        observation, info = super().reset(seed=seed, options=None if start is None else {"start": start[:-1]})
        return observation, info | {"case": self.case}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = super().step(action)
        self.place = self.place + self.wind
        return observation, reward, terminated, truncated, info | {"case": self.case}

    def start_state(self) -> np.ndarray:
        return np.append(self.place, float(self.case))

    def state(self) -> dict[str, Any]:
        return super().state() | {"case": self.case}

    def restore(self, state: dict[str, Any]) -> Any:
        self.case = state["case"]
        return super().restore(state)


class WatchedEnv(WindyEnv):
    """Notes the case of every episode."""

    def __init__(self, played: list[int]) -> None:
        super().__init__()
        self.played = played

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:  # type: ignore[override]
        observation, info = super().reset(**arguments)
        self.played.append(info["case"])
        return observation, info


@pytest.fixture(scope="module")
def learnt() -> Policy:
    """What a rehearsal from nothing leaves."""
    starts = [np.array([[0.2, 0.2, float(case)], [-0.3, 0.1, float(case)]]) for case in range(3)]
    return rehearse(WindyEnv, settings=FROM_NOTHING, starts=starts, seed=3).policy


def test_it_learns_in_all_cases_and_then_starts_from_that(learnt: Policy) -> None:
    outcome = play_cases(learnt, WindyEnv(), seed=7)
    assert outcome.success.sum() >= 2
    assert outcome.success.shape == outcome.steps.shape == (3,)
    assert len(outcome.forces) == outcome.steps.sum()
    assert outcome.force_p95 == pytest.approx(np.percentile(outcome.forces, 95))
    # the network of the policy wins over that of the settings
    settings = dataclasses.replace(FROM_NOTHING, hidden=(8,), decisions=96, evaluate_every=96)
    second = rehearse(WindyEnv, settings=settings, policy=learnt, seed=4)
    assert second.policy.network.hidden == (32, 32)
    assert play_cases(second.policy, WindyEnv(), seed=7).success.sum() >= 2


def test_what_others_show_is_learnt_from_nothing_and_from_a_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    def straight(observation: Any, info: dict[str, Any]) -> np.ndarray:
        return np.clip(-20.0 * observation["place"][:2], -1.0, 1.0)

    env = WindyEnv()
    shown = [demonstrated(straight, env, case, ("place",), seed=case) for case in range(3)]
    for case, episode in enumerate(shown):
        assert episode.terminated
        assert set(episode.simulation_states[:, -1]) == {float(case)}
        _, info = env.reset(options={"start": episode.simulation_states[-2]})
        assert info["case"] == case
        np.testing.assert_allclose(info["tip"][:2], episode.simulation_states[-2][:2])
    used: list[TrainingSettings] = []
    usual = Training.__init__
    monkeypatch.setattr(
        Training,
        "__init__",
        lambda self, settings, *rest, **named: usual(self, used.append(settings) or settings, *rest, **named),
    )
    short = dataclasses.replace(FROM_NOTHING, decisions=960, evaluate_every=480, demonstrations_in_replay=0.0)
    first = rehearse(WindyEnv, settings=short, demonstrations=shown, seed=3)
    assert play_cases(first.policy, WindyEnv(), seed=7).success.sum() >= 2
    short = dataclasses.replace(short, decisions=240, learning_starts=50, evaluate_every=240)
    rehearse(WindyEnv, settings=short, policy=first.policy, demonstrations=shown, seed=3)
    assert [one.demonstrations_in_replay for one in used] == [DEMONSTRATION_SHARE] * 2
    assert used[1].learning_rate == pytest.approx(DEMONSTRATION_SLOWER * used[0].learning_rate)
    assert used[1].learning_starts == max(short.learning_starts, round(DEMONSTRATION_FIRST * 240))


def test_an_evaluation_plays_every_case_as_often() -> None:
    played: list[int] = []
    watched = partial(WatchedEnv, played)
    settings = dataclasses.replace(
        FROM_NOTHING, decisions=400, evaluate_every=400, evaluation_episodes=6, keep_latest=True
    )
    rehearse(WindyEnv, make_validation_env=watched, settings=settings, seed=5)
    assert len(played) in (3, 6)  # where none of the scouts arrives, the others are not played
    assert sorted(played) == sorted(list(range(3)) * (len(played) // 3))


def test_the_first_evaluation_can_be_played_before_and_is_the_same(learnt: Policy) -> None:
    settings = dataclasses.replace(
        FROM_NOTHING, decisions=96, evaluate_every=96, evaluation_episodes=6, keep_latest=True
    )
    played: list[int] = []
    watched = partial(WatchedEnv, played)

    def curve(**given: Any) -> list[float | None]:
        played.clear()
        result = rehearse(WindyEnv, make_validation_env=watched, settings=settings, policy=learnt, seed=5, **given)
        return [row["evaluation_success"] for row in result.curve]

    usual, twice = curve(), len(played)
    before = first_evaluation(learnt, watched, settings, seed=5)
    once = len(played) - twice
    assert usual[0] == before.success > 0
    assert curve(first_result=before) == usual
    assert len(played) == twice - once
