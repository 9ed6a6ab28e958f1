"""Devices for an anatomy: by trials in copies, and by how a branch leaves the arch."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.anatomy import Phantom
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.arch_parameters import ArchParameters
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.phantom import locate_targets
from cathsim.anatomy.vessel_tree import set_back
from cathsim.rehearsal.environment import NavigateCopiesEnv
from enn.device_trials import FIRST, TRIALS, TrialStatistics, best_devices, gentlest, soonest, try_in_copies
from pipeline.anatomies.devices import STEEP_MM, best_in_copies, softened, with_catheter_where_steep
from pipeline.task import Task


class Straight:
    """Feeds the wire at a speed, and remembers the seeds of its controllers."""

    keys = ("tip",)

    def __init__(self, speed: float) -> None:
        self.speed, self.seeds = speed, list[int]()

    def controller(self, *, deterministic: bool, seed: int) -> Callable[[Any, Any], np.ndarray]:
        assert not deterministic
        self.seeds.append(seed)
        return lambda observation, info: np.array([self.speed, 0.0])


def copies(**changed: Any) -> NavigateCopiesEnv:
    return NavigateCopiesEnv("type_1", ("bca",), copies=(1, 2, 3), observation="tip", accuracy="fast", **changed)


def test_an_episode_in_each_copy_is_counted_as_it_went() -> None:
    near = copies(max_steps=120, success_radius=0.05, success="straight")  # half way is enough
    policy, done = Straight(1.0), list[float]()
    trials = try_in_copies(policy, near, 7, cases=range(3), tick=done.append)  # type: ignore[arg-type]
    tried = TrialStatistics.of(trials)
    assert (tried.reached, tried.episodes) == (3, 3)
    assert tried.steps < 120
    assert 0 < tried.force_p95 < 2
    assert policy.seeds == [7, 8, 9]
    assert done == pytest.approx([0, 1 / 3, 2 / 3, 1])
    still = TrialStatistics.of(try_in_copies(Straight(0.0), copies(max_steps=5), 7, cases=range(3)))  # type: ignore[arg-type]
    assert (still.reached, still.steps) == (0, 5)
    assert str(still) == f"0 of 3 ({still.force_p95:.2f} N)"

    # each copy plays the same whichever others do
    assert try_in_copies(policy, near, 7, cases=(1,)) == trials[1:2]  # type: ignore[arg-type]
    assert policy.seeds[-1] == 8


def test_the_most_arrivals_win_then_the_usual_devices_then_the_soonest() -> None:
    slow = TrialStatistics(2, 4, 90.0, 0.1)
    quick = TrialStatistics(2, 4, 80.0, 0.3)
    often = TrialStatistics(3, 4, 200.0, 0.9)
    assert soonest([slow, quick, often]) == 2
    assert soonest([slow, quick]) == 0
    assert soonest([often, slow, often, quick], 2) == 2
    assert soonest([TrialStatistics(0, 4, 300.0, 0.1), slow, quick]) == 2


def test_others_are_tried_only_where_the_usual_devices_fail_at_first() -> None:
    asked: list[tuple[int, int]] = []

    def trying(number: int, shares: float) -> Callable[[int], TrialStatistics]:
        def play(episodes: int) -> TrialStatistics:
            asked.append((number, episodes))
            return TrialStatistics(int(shares * episodes), episodes, 100.0, 0.2)

        return play

    assert best_devices([trying(0, 0.5), trying(1, 1.0)], 1) == 1
    assert asked == [(1, FIRST)]
    asked.clear()
    assert best_devices([trying(0, 0.5), trying(1, 0.2), trying(2, 0.9)], 1) == 2
    assert asked == [(1, FIRST), (0, TRIALS), (1, TRIALS), (2, TRIALS)]


def test_devices_are_tried_in_copies_of_the_anatomy() -> None:
    phantom = load_phantom("type_1")
    middle = tuple(float(x) for x in phantom.tree.root.point_at(0.25 * phantom.tree.root.length))  # above the entry
    task = Task(max_steps=60, success_radius_mm=15.0)
    still, straight = Straight(0.0), Straight(1.0)

    best = best_in_copies((still, straight), [task, task], phantom, middle, usual=0, seed=5)  # type: ignore[arg-type]
    assert best == 1
    assert still.seeds == [5, 6, 7, 5, 6, 7, 8, 9, 10]
    assert straight.seeds == [5, 6, 7, 8, 9, 10]


def test_the_gentlest_is_chosen_among_those_that_arrive_about_as_often_as_the_best() -> None:
    wire = TrialStatistics(2, 4, 90.0, 0.2)
    both = TrialStatistics(4, 4, 80.0, 0.4)
    never = TrialStatistics(0, 4, 300.0, 0.05)
    assert gentlest([wire, TrialStatistics(3, 4, 80.0, 0.4), never]) == 0
    assert gentlest([TrialStatistics(3, 4, 90.0, 0.2), both, never]) == 0
    assert gentlest([wire, both, never]) == 1  # two episodes fewer
    assert gentlest([never, both]) == 1
    assert gentlest([TrialStatistics(1, 4, 90.0, 0.1), wire]) == 1  # in less than half
    assert gentlest([never, TrialStatistics(1, 4, 250.0, 0.5)]) == 1  # none arrives as often


def test_those_that_press_too_hard_are_taken_only_where_no_other_arrives() -> None:
    wire = TrialStatistics(2, 4, 90.0, 0.2)
    both = TrialStatistics(4, 4, 80.0, 0.4)
    never = TrialStatistics(0, 4, 300.0, 0.02)
    assert gentlest([wire, both, never], 0.4) == 1
    assert gentlest([wire, both, never], 0.3) == 0  # the best presses too hard
    rarely = TrialStatistics(1, 4, 90.0, 0.1)
    assert gentlest([rarely, both, never], 0.4) == 1
    assert gentlest([rarely, both, never], 0.3) == 1  # what seldom arrives has little to learn from
    assert gentlest([TrialStatistics(1, 4, 90.0, 0.35), both, never], 0.3) == 1  # and nothing gentler arrives
    hard = TrialStatistics(3, 8, 80.0, 0.56)
    soft = TrialStatistics(4, 16, 90.0, 0.16)
    softest = TrialStatistics(1, 8, 85.0, 0.05)
    assert gentlest([never, hard, softest, soft], 0.3) == 3  # of those below half the most arrivals
    assert gentlest([never, hard, soft]) == 1
    thin = TrialStatistics(3, 4, 90.0, 0.03)
    pair = TrialStatistics(4, 4, 95.0, 0.05)  # hardly press: the most arrivals decide
    assert gentlest([thin, TrialStatistics(4, 4, 80.0, 0.12), pair], 0.3) == 2
    assert gentlest([thin, TrialStatistics(4, 4, 80.0, 0.19)], 0.3) == 0


@pytest.fixture(scope="module")
def steep() -> Phantom:
    """An arch whose top lies far above the origins of BCA and LCCA."""
    tree = build_arch(ArchParameters(apex_ratio=3.6))
    grid = build_lumen(tree, resolution=2e-3, fillet_radius=2.5e-3)
    return Phantom("steep", "0", None, tree, grid, locate_targets(tree), {})


def test_a_steep_take_off_gets_a_catheter_or_a_word(steep: Phantom, caplog: pytest.LogCaptureFixture) -> None:
    back = 1e3 * set_back(steep.tree, "lcca")
    assert back >= STEEP_MM
    with caplog.at_level(logging.WARNING):
        assert with_catheter_where_steep(steep, "lcca", Task(), choose=True) == Task(catheter="jb2")
    assert f"lcca of steep leaves the aorta steeply: its ostium lies {back:.0f} mm behind" in caplog.text
    caplog.clear()
    assert with_catheter_where_steep(steep, "lcca", Task(), choose=False) == Task()
    assert "task.catheter=jb2 reaches further" in caplog.text


def test_elsewhere_the_devices_stay_and_nothing_is_said(steep: Phantom, caplog: pytest.LogCaptureFixture) -> None:
    assert 1e3 * set_back(steep.tree, "lsa") < STEEP_MM
    middle = tuple(float(x) for x in steep.tree.root.point_at(steep.tree.root.length / 2))
    task = Task()
    with caplog.at_level(logging.WARNING):
        for target, given in (
            ("lsa", task),
            ("lcca", replace(task, catheter="vertebral")),
            ("lcca", replace(task, entry="ascending")),
            (middle, task),
        ):
            assert with_catheter_where_steep(steep, target, given, choose=True) == given
    assert not caplog.text


def test_softer_devices_are_those_of_a_jb2_over_the_usual_wire() -> None:
    task = Task(catheter="jb2", max_steps=7)
    soft = softened(task)
    assert soft == replace(task, catheter="jb2_4f", wire="radifocus_angled_025")
    usual, pair = task.pair(), soft.pair()
    assert pair.wire is not None
    assert usual.wire is not None
    assert pair.wire.stiffness(0.2) + pair.catheter.stiffness(0.2) < 0.25 * (
        usual.wire.stiffness(0.2) + usual.catheter.stiffness(0.2)
    )
    assert softened(replace(task, wire="stiff")) == replace(task, catheter="jb2_4f", wire="stiff")
    for other in (Task(), Task(catheter="simmons2"), soft):
        assert softened(other) == other
