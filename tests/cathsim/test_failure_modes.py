"""Failure modes: where the tip ended, against the branches of a phantom."""

from __future__ import annotations

import numpy as np

from cathsim import load_phantom
from cathsim.metrics.failure_modes import ABORTED, OVERSHOOT, STUCK, WRONG_BRANCH, failure_mode, places


def test_failure_modes() -> None:
    phantom = load_phantom("type_1")
    tree = {branch.name: branch for branch in phantom.tree.branches}
    aorta, steps = tree["aorta"], 60

    def mode(end: np.ndarray, target: str = "lcca") -> str:
        way = np.concatenate((aorta.points[:20], np.repeat(end[None], steps - 19, axis=0)))
        return failure_mode(phantom, target, way, steps_allowed=steps, entry="descending")

    assert places(phantom, tree["lsa"].point_at([0.05]))[0] == ["lsa"]
    assert mode(tree["lsa"].point_at(0.05)) == WRONG_BRANCH
    assert mode(tree["bca"].point_at(0.045)) == WRONG_BRANCH
    assert mode(tree["lcca"].point_at(0.04)) == STUCK
    assert mode(tree["rsa"].point_at(0.02), "bca") == WRONG_BRANCH
    take_off = tree["lcca"].parent_arc
    assert mode(aorta.point_at(take_off - 0.03)) == STUCK
    assert mode(aorta.point_at(take_off + 0.005)) == STUCK
    assert mode(aorta.point_at(take_off + 0.03)) == OVERSHOOT
    short = failure_mode(phantom, "lcca", aorta.points[:30], steps_allowed=steps, entry="descending")
    assert short == ABORTED
