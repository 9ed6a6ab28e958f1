"""Metrics against values worked out by hand."""

import json

import numpy as np
import pytest

from cathsim.metrics import (
    EpisodeMetrics,
    force_magnitudes,
    path_length,
    safety,
    shortest_successful_paths,
    spl,
    summarise,
)


def straight_episode(length, steps, *, success=True, force=0.5, target="bca"):
    tips = np.zeros((steps + 1, 3))
    tips[:, 2] = np.linspace(0, length, steps + 1)
    return EpisodeMetrics.from_arrays(tips, np.full(steps, force), np.full(steps, -0.1), success, target=target)


def test_force_magnitude_is_the_norm_of_the_resultant():
    assert force_magnitudes([[3.0, 4.0, 12.0], [0.0, 0.0, 0.0]]) == pytest.approx([13.0, 0.0])
    assert force_magnitudes([0.1, 0.2]) == pytest.approx([0.1, 0.2])


def test_path_length_sums_the_steps_of_the_tip():
    square = [[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0], [0, 0.01, 0], [0, 0, 0]]
    assert path_length(square) == pytest.approx(0.04)
    assert path_length([[1.0, 2.0, 3.0]]) == 0.0


def test_a_force_at_the_limit_is_unsafe():
    assert safety([0.0, 1.999, 2.0, 5.0]) == pytest.approx(0.5)
    assert safety([0.4, 0.6], limit=0.5) == pytest.approx(0.5)


def test_spl_by_hand():
    # 0.2/0.2, 0.2/0.4, a failure, and a way shorter than the optimum, which counts as 1
    assert spl([True, True, False, True], [0.2, 0.4, 0.1, 0.15], 0.2) == pytest.approx((1 + 0.5 + 0 + 1) / 4)
    assert spl([True, True], [0.2, 0.3], [0.1, 0.3]) == pytest.approx(0.75)
    assert spl([False], [0.3], np.nan) == 0.0
    assert spl([True], [0.0], 0.0) == 1.0


def test_episode_metrics_by_hand():
    tips = np.array([[0, 0, 0], [0, 0, 0.003], [0, 0.004, 0.003]])
    episode = EpisodeMetrics.from_arrays(tips, [[0, 0, 1.0], [0, 3.0, 0]], [-1.0, 10.0], True, target="lcca")
    assert (episode.force_mean, episode.force_max, episode.steps) == (2.0, 3.0, 2)
    assert episode.force_p95 == pytest.approx(2.9)
    assert episode.path_length == pytest.approx(0.007)
    assert episode.safety == 0.5
    assert episode.reward == 9.0
    assert episode.success
    assert episode.target == "lcca"


def test_summary_has_the_units_and_the_spread_of_the_tables():
    episodes = [straight_episode(0.16, 40, force=1.0), straight_episode(0.20, 60, force=3.0)]
    episodes += [straight_episode(0.30, 300, success=False, force=2.0)]
    summary = summarise(episodes)
    assert summary.episodes == 3
    assert summary.force_n.mean == pytest.approx(2.0)
    assert summary.force_n.sd == pytest.approx(np.sqrt(2 / 3))
    assert summary.path_length_cm.mean == pytest.approx(22.0)
    assert summary.episode_length_steps.mean == pytest.approx(400 / 3)
    assert summary.safety_pct.mean == pytest.approx(100 / 3)
    assert summary.success_pct.mean == pytest.approx(200 / 3)
    assert summary.success_pct.sd == pytest.approx(100 * np.sqrt(2) / 3)
    assert summary.spl_pct == pytest.approx(100 * (1 + 0.8 + 0) / 3)
    assert summary.reward.mean == pytest.approx(-40 / 3)
    assert json.loads(json.dumps(summary.as_dict()))["path_length_cm"][0] == pytest.approx(22.0)


def test_each_target_has_its_own_optimum():
    episodes = [straight_episode(0.1, 5, target="bca"), straight_episode(0.4, 5, target="lcca")]
    assert shortest_successful_paths(episodes) == pytest.approx({"bca": 0.1, "lcca": 0.4})
    assert summarise(episodes).spl_pct == pytest.approx(100.0)
    assert summarise(episodes, shortest={"bca": 0.1, "lcca": 0.2}).spl_pct == pytest.approx(75.0)
    assert summarise(episodes, shortest=[0.05, 0.4]).spl_pct == pytest.approx(75.0)


def test_failures_alone_give_no_optimum_and_no_spl():
    episodes = [straight_episode(0.1, 5, success=False)]
    assert shortest_successful_paths(episodes) == {}
    assert summarise(episodes).spl_pct == 0.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: summarise([]), "at least one episode"),
        (
            lambda: summarise([straight_episode(0.1, 5)], shortest={"lsa": 0.1}),
            "no optimal path length for target 'bca'",
        ),
        (lambda: summarise([straight_episode(0.1, 5)], shortest=[0.1, 0.2]), "one optimal length for each of 1"),
        (lambda: spl([True], [0.1], np.nan), "finite optimal length"),
        (lambda: spl([], [], 0.1), "at least one episode"),
        (lambda: force_magnitudes([np.nan]), "finite and not negative"),
        (lambda: force_magnitudes(np.zeros((3, 2))), r"shape \(T,\) or \(T, 3\)"),
        (lambda: path_length(np.zeros((3, 2))), "shape"),
        (lambda: EpisodeMetrics.from_arrays(np.zeros((3, 3)), [0.1] * 3, [0.0] * 3, True), r"T \+ 1 tip positions"),
        (lambda: EpisodeMetrics.from_arrays(np.zeros((1, 3)), [], [], False), "T >= 1"),
        (lambda: EpisodeMetrics.from_arrays(np.zeros((2, 3)), [0.1], [np.inf], False), "rewards must be finite"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
