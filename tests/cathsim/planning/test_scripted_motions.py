"""Scripted motions: moves within limits, and shapes of a wire that begin where the path does."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.planning.scripted_motions import (
    MAX_ADVANCE,
    MAX_TURN,
    MOTIONS,
    ROOT,
    RandomMoves,
    Script,
    ScriptedOperator,
    arch_branches,
    placement_paths,
)


@pytest.mark.parametrize("motion", MOTIONS)
def test_moves_stay_within_what_a_hand_can_do(motion: str) -> None:
    moves = []
    for _ in range(2):
        source = RandomMoves(motion, np.random.default_rng(5))
        moves.append(np.array([source.next() for _ in range(2000)]))
    assert np.array_equal(*moves)
    assert np.abs(moves[0][:, 0]).max() <= MAX_ADVANCE
    assert np.abs(moves[0][:, 1]).max() <= MAX_TURN
    assert np.sign(moves[0][:, 0].mean()) == (-1 if motion == "withdraw" else 1)


def test_paths_lead_from_the_entry_to_every_end_of_a_branch() -> None:
    phantom = load_phantom("type_1")
    assert {"bca", "lcca"} <= set(arch_branches(phantom))
    entry = phantom.entry("descending").position
    for target in (*arch_branches(phantom), ROOT):
        for path in placement_paths(phantom, target):
            assert np.linalg.norm(path[0] - entry) < 0.01
            assert (phantom.grid.sample(path) > 0).mean() > 0.95  # inside the lumen
    assert placement_paths(phantom, "bca") is placement_paths(phantom, "bca")


def test_a_script_repeats_itself_and_a_tip_that_nobody_sees_ends_in_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script("type_1", "bca", "angled", shapes=2, steps=1, seed=3)
    operator = ScriptedOperator(load_phantom("type_1"), "angled")
    motion, shapes = operator.film(script, lambda tip: True)
    again, same = operator.film(script, lambda tip: True)
    assert motion == again
    assert motion in MOTIONS
    assert all(np.array_equal(one, other) for one, other in zip(shapes, same, strict=True))
    monkeypatch.setattr("cathsim.planning.scripted_motions._RESTARTS", 1)
    with pytest.raises(RuntimeError, match="came to an end"):
        operator.film(script, lambda tip: False)
