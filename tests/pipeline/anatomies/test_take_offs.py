"""Steep take-offs: where a catheter is put over the wire, or named, and where not."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest

from cathsim.anatomy import Phantom
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.arch_parameters import ArchParameters
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.phantom import locate_targets
from cathsim.anatomy.vessel_tree import set_back
from pipeline.anatomies.devices import STEEP_MM, softened, with_catheter_where_steep
from pipeline.task import Task


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
    assert "stage.choose_catheter=false leaves it out" in caplog.text
    caplog.clear()
    assert with_catheter_where_steep(steep, "lcca", Task(), choose=False) == Task()
    assert "stage.catheter=jb2 reaches further" in caplog.text


def test_elsewhere_the_devices_stay_and_nothing_is_said(steep: Phantom, caplog: pytest.LogCaptureFixture) -> None:
    assert 1e3 * set_back(steep.tree, "lsa") < STEEP_MM
    middle = steep.tree.root.point_at(steep.tree.root.length / 2)
    task = Task()
    with caplog.at_level(logging.WARNING):
        for target, given in (
            ("lsa", task),
            ("lcca", replace(task, catheter="vertebral")),
            ("lcca", replace(task, entry="ascending")),
            ((float(middle[0]), float(middle[1]), float(middle[2])), task),
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
