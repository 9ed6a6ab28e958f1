"""The X-ray room: contrast medium comes and goes, the pedal counts, impossible angles are refused."""

from __future__ import annotations

import pytest

from cathsim.console.xray.monitor import CArm
from cathsim.console.xray.room import FILLING, WASHOUT, XRayRoom, XRayStep, concentration


def test_contrast_fills_and_washes_out() -> None:
    assert concentration(-1.0) == 0.0
    assert concentration(FILLING / 2) == pytest.approx(0.5)
    assert concentration(FILLING) == pytest.approx(1.0)
    assert concentration(FILLING + WASHOUT) == pytest.approx(0.3679, abs=1e-4)
    assert concentration(30.0) == 0.0


def test_the_dose_is_the_control_steps_in_which_the_beam_was_on() -> None:
    room = XRayRoom()
    assert room.contrast == 0.0
    room.advance(1.0)
    assert room.dose == 0.0, "no step has begun"
    assert [room.step().on for _ in range(3)] == [True] * 3
    room.beam = False
    assert not room.step().on
    room.beam = True
    room.beam = False
    assert [room.step().on for _ in range(2)] == [True, False], "a tap counts for one step"
    assert room.dose == pytest.approx(0.4)
    room.beam = True
    room.beam = False
    room.wait()
    assert not room.step().on, "nor does a tap before the procedure"


def test_injections_are_told_to_the_step_after_them() -> None:
    room = XRayRoom()
    room.inject()
    room.inject()
    assert [room.step().injections for _ in range(2)] == [2, 0]
    room.inject()
    room.advance(FILLING)
    assert (room.contrast, room.injections, room.step().injections) == (1.0, 3, 1)
    room.beam = False
    room.restart()
    assert (room.contrast, room.injections, room.dose, room.beam) == (0.0, 0, 0.0, False)
    assert room.step() == XRayStep(on=False, injections=0)


def test_a_c_arm_turns_within_its_limits() -> None:
    assert CArm(primary_deg=-30, secondary_deg=20, zoom=2).zoom == 2
    for wrong in ({"primary_deg": 180}, {"secondary_deg": 60}, {"zoom": 0.5}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            CArm(**wrong)
