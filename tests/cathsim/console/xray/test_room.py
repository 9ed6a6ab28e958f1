"""The X-ray room: contrast medium comes and goes, the pedal counts, impossible angles are refused."""

from __future__ import annotations

import pytest

from cathsim.console.xray.monitor import CArm
from cathsim.console.xray.room import FILLING, WASHOUT, XRayRoom, concentration


def test_contrast_fills_and_washes_out() -> None:
    assert concentration(-1.0) == 0.0
    assert concentration(FILLING / 2) == pytest.approx(0.5)
    assert concentration(FILLING) == pytest.approx(1.0)
    assert concentration(FILLING + WASHOUT) == pytest.approx(0.3679, abs=1e-4)
    assert concentration(30.0) == 0.0


def test_the_pedal_counts_only_while_the_beam_is_on_in_a_procedure() -> None:
    room = XRayRoom()
    assert room.contrast == 0.0
    room.advance(1.0, counting=False)
    room.advance(2.0, counting=True)
    room.beam = False
    room.advance(4.0, counting=True)
    assert room.dose == 2.0
    room.inject()
    room.advance(FILLING, counting=True)
    assert (room.contrast, room.injections) == (1.0, 1)
    room.restart()
    assert (room.contrast, room.injections, room.dose, room.beam) == (0.0, 0, 0.0, False)


def test_a_c_arm_turns_within_its_limits() -> None:
    assert CArm(primary_deg=-30, secondary_deg=20, zoom=2).zoom == 2
    for wrong in ({"primary_deg": 180}, {"secondary_deg": 60}, {"zoom": 0.5}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            CArm(**wrong)
