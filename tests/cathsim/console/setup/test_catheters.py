"""The catheters that the page offers."""

from __future__ import annotations

import pytest

from cathsim.console.setup.choices import OWN, find_offer, offered
from cathsim.devices.shelf import SHAPES, load_catheter


def test_the_shelf_is_offered_in_every_size() -> None:
    offers = offered(None)
    assert {offer.shape for offer in offers} == set(SHAPES)
    assert len({offer.name for offer in offers}) == len(offers) == 3 * len(SHAPES)
    for offer in offers:
        assert load_catheter(offer.source) == load_catheter(offer.shape, french=offer.french)


def test_a_shape_without_its_size_is_that_of_the_default_size() -> None:
    offers = offered("simmons2")
    assert find_offer(offers, "simmons2").name == "simmons2_5f"
    assert find_offer(offers, "simmons2_6f").french == 6
    with pytest.raises(ValueError, match="unknown catheter 'simmons2_9f'; there are straight_4f, straight_5f"):
        find_offer(offers, "simmons2_9f")


def test_ones_own_file_comes_first_and_by_no_path() -> None:
    offers = offered("/somewhere/mine.yaml")
    assert (offers[0].name, offers[0].shape, offers[0].french) == (OWN, "mine", None)
    assert find_offer(offers, OWN).source == find_offer(offers, "/somewhere/mine.yaml").source == "/somewhere/mine.yaml"
    assert "somewhere" not in str(offers[0].to_page())
