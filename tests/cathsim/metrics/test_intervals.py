"""Wilson's interval of a share."""

from __future__ import annotations

import pytest

from cathsim.metrics.episodes import wilson_interval


def test_wilson_interval_is_the_textbook_one() -> None:
    assert wilson_interval(30, 30) == (pytest.approx(0.8865, abs=1e-4), 1.0)
    assert wilson_interval(0, 30) == (0.0, pytest.approx(0.1135, abs=1e-4))
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, table I
    with pytest.raises(ValueError, match="got 3 of 2"):
        wilson_interval(3, 2)
