"""Entries: the aorta's ends, open ends of branches, points in the lumen."""

import numpy as np
import pytest

from cathsim.anatomy import Phantom
from cathsim.anatomy.entry import AHEAD, ENTRY_DEPTH, end_names, entry_name, read_point


def test_open_end_of_a_branch_leads_into_it(phantom: Phantom) -> None:
    names = end_names(phantom.tree)
    assert set(names) >= {"lcca_end", "lsa_end", "rsa_end", "rcca_end"}
    assert "bca_end" not in names  # others continue it
    for name in names:
        entry, branch = phantom.entry(name), phantom.tree[name.removesuffix("_end")]
        assert np.linalg.norm(entry.position - branch.points[-1]) == pytest.approx(ENTRY_DEPTH, rel=0.01)
        assert np.linalg.norm(entry.direction) == pytest.approx(1.0)
        assert entry.direction @ branch.tangents[-1] < -0.99
        assert phantom.grid.sample(entry.position + AHEAD * entry.direction) > 1.5e-3
        assert phantom.way_length("bca", name) > 0.02


def test_sheath_of_a_point_follows_the_centreline(phantom: Phantom) -> None:
    """Up the aorta, and in a branch down towards it, unless the target lies the other way."""
    aorta, lsa = phantom.tree.root, phantom.tree["lsa"]
    above = aorta.point_at(0.9 * aorta.length)  # between the branches and the heart
    assert phantom.entry(above).direction @ aorta.tangent_at(0.9 * aorta.length) > 0.999
    back = phantom.entry(entry_name(above, "lsa"))
    assert back.direction @ aorta.tangent_at(0.9 * aorta.length) < -0.999
    assert np.array_equal(back.position, above)
    low = phantom.entry(entry_name(tuple(aorta.point_at(0.05)), "lsa"))
    assert low.direction @ aorta.tangent_at(0.05) > 0.999
    within = 0.7 * lsa.length
    place = lsa.point_at(within)
    assert phantom.entry(place).direction @ lsa.tangent_at(within) < -0.999
    assert phantom.entry(entry_name(place, "bca")).direction @ lsa.tangent_at(within) < -0.999
    assert phantom.entry(entry_name(place, "lsa_end")).direction @ lsa.tangent_at(within) > 0.999
    beyond = lsa.point_at(0.9 * lsa.length)
    assert phantom.entry(entry_name(place, beyond)).direction @ lsa.tangent_at(within) > 0.999


@pytest.mark.parametrize("target", [None, "lcca", (0.01, -0.02, 0.03)])
def test_text_of_a_point_gives_it_back_exactly(target: object) -> None:
    point = tuple(np.random.default_rng(0).uniform(-0.1, 0.1, 3).tolist())
    text = entry_name(point, target)
    assert read_point(text) == (point, target)
    assert entry_name(text, "bca") == text
    assert read_point("descending") is None
    assert read_point("(1e-3, 2e-3, 0.1)") == ((1e-3, 2e-3, 0.1), None)


def test_impossible_entries_are_refused(phantom: Phantom) -> None:
    with pytest.raises(
        ValueError, match=r"unknown entry 'bca_end'.*choose from descending, ascending, .*or give a point"
    ):
        phantom.entry("bca_end")
    with pytest.raises(ValueError, match=r"the entry \(0.5, 0, 0\) m lies outside the lumen .*nearest place inside"):
        phantom.entry((0.5, 0.0, 0.0))
    with pytest.raises(ValueError, match="an entry is a name, or a point of three coordinates in m"):
        phantom.entry((0.1, 0.2))
    with pytest.raises(ValueError, match="an entry's coordinates are in metres"):
        phantom.entry((12.0, 40.0, 90.0))
    with pytest.raises(ValueError, match="unknown target 'brain'"):
        phantom.entry(entry_name(phantom.entry().position, "brain"))
    aorta = phantom.tree.root
    with pytest.raises(ValueError, match="would point at the wall of aorta within 5 mm: move the entry"):
        phantom.entry(aorta.point_at(aorta.length - 2e-3))
    phantom.entry(entry_name(aorta.point_at(aorta.length - 2e-3), "lcca"))
