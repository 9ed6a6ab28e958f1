"""Tests of a pair of devices."""

from __future__ import annotations

import pytest

from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.guidewire import load_guidewire


def test_links_are_as_long_as_asked_and_finer_at_the_end() -> None:
    for catheter in ("vertebral", "simmons2"):
        pair = DevicePair(load_guidewire("default"), load_catheter(catheter), reach=0.4)
        links = pair.links()
        assert sum(links) >= 0.4
        assert list(links) == sorted(links, reverse=True)


def test_longer_than_the_devices() -> None:
    with pytest.raises(ValueError, match="longer than the shorter device"):
        DevicePair(load_guidewire("default"), load_catheter("vertebral"), reach=1.4)
