"""Labels of vessels: gaps, specks, holes, which vessel leaves which, paths, parts that smoothing has parted."""

import numpy as np
import pytest

from cathsim.anatomy.volume.labels.family import find_family
from cathsim.anatomy.volume.labels.parts import clean_parts, led_on
from cathsim.anatomy.volume.lumen import paths
from cathsim.anatomy.volume.lumen.graph import LumenGraph
from cathsim.anatomy.volume.lumen.smoothing import ways_to_lost

SPACING = np.full(3, 1e-3)
NAMES = ("aorta", "lcca", "lsa")
AORTA, LCCA, LSA = 1, 2, 3


def arch() -> np.ndarray:
    """An aorta of 20 x 20 x 40 voxels with an LCCA and an LSA of 6 x 6 x 30 voxels each on it, 14 apart."""
    box = np.zeros((40, 26, 76), dtype=np.uint8)
    box[4:36, 3:23, 3:40] = AORTA
    box[6:12, 10:16, 40:72] = LCCA
    box[26:32, 10:16, 40:72] = LSA
    return box


def test_a_tip_with_a_neighbours_label_goes_back_to_its_vessel() -> None:
    box = arch()
    box[6:12, 10:16, 60:72] = LSA
    notes = clean_parts(box, NAMES, SPACING)
    np.testing.assert_array_equal(box, arch())
    assert len(notes) == 1
    assert "of lsa is taken for lcca" in notes[0]


def test_a_part_behind_a_small_gap_stays_its_vessels_even_if_it_touches_another() -> None:
    box = arch()
    box[6:12, 10:16, 56:58] = 0
    box[12:14, 10:16, 60:70] = AORTA
    box[12:14, 10:16, 40:60] = AORTA
    notes = clean_parts(box, NAMES, SPACING)
    assert (box[6:12, 10:16, 58:72] == LCCA).all()
    assert (box[8:10, 12:14, 40:72] == LCCA).all()
    assert any("in lcca is closed" in note for note in notes)


def test_specks_go_in_the_open_and_become_the_vessel_within_it() -> None:
    box = arch()
    box[20, 12, 60] = LCCA
    box[15:17, 10:12, 20] = LSA
    clean_parts(box, NAMES, SPACING)
    np.testing.assert_array_equal(box, arch())


@pytest.mark.parametrize("shape", [slice(15, 17), slice(12, 24)])
def test_holes_are_filled_and_hollows_at_the_wall_are_not(shape: slice) -> None:
    box = arch()
    box[shape, 9:15, 16:28] = 0
    notes = clean_parts(box, NAMES, SPACING)
    np.testing.assert_array_equal(box, arch())
    assert any("holes of" in note for note in notes)
    box[shape, 3:8, 20:26] = 0
    hollow = box.copy()
    clean_parts(box, NAMES, SPACING)
    np.testing.assert_array_equal(box, hollow)


def test_a_ring_of_vessels_is_no_hole() -> None:
    box = np.zeros((30, 30, 50), dtype=np.uint8)
    box[2:28, 2:28, 10:14] = AORTA
    box[8:22, 8:22, 10:14] = 0
    ring = box.copy()
    clean_parts(box, ("aorta",), SPACING)
    np.testing.assert_array_equal(box, ring)


def slanted(gap: int) -> tuple[np.ndarray, np.ndarray]:
    """An aorta and an LCCA that leaves it at 40 degrees from the normal, as it should be and with its foot cut off."""
    x, y, z = np.meshgrid(np.arange(60), np.arange(24), np.arange(60), indexing="ij")
    direction = np.array([np.sin(0.7), 0.0, np.cos(0.7)])
    offset = np.stack([x - 14, y - 12, z - 20], axis=-1).astype(float)
    along = offset @ direction
    vessel = (np.linalg.norm(offset - along[..., None] * direction, axis=-1) <= 4) & (along > 0) & (along < 40)
    whole = np.where((z >= 3) & (z < 20) & (np.abs(y - 12) < 9), AORTA, 0).astype(np.uint8)
    whole[vessel & (whole == 0)] = LCCA
    cut = whole.copy()
    cut[vessel & (along < gap + 4) & (cut == LCCA)] = 0
    return whole, cut


@pytest.mark.parametrize("gap", [2, 5])
def test_a_vessel_is_led_on_to_its_parent_along_its_axis(gap: int) -> None:
    whole, box = slanted(gap)
    ours, theirs = (np.argwhere(box == number) * SPACING for number in (LCCA, AORTA))
    led = led_on(box, LCCA, ours, theirs, SPACING)
    assert led[1] == pytest.approx(4e-3, abs=0.5e-3)
    found, wanted = box == LCCA, whole == LCCA
    assert np.count_nonzero(found & wanted) > 0.93 * np.count_nonzero(wanted)
    assert np.count_nonzero(found & ~wanted) < 0.05 * np.count_nonzero(wanted)
    assert (box[whole == AORTA] == AORTA).all()


def test_a_vessel_of_which_one_side_touches_its_parent_is_led_on() -> None:
    whole, _ = slanted(0)
    x, _, z = np.indices(whole.shape)
    missing = (whole == LCCA) & (z < 26) & (x - 15 < np.tan(0.7) * (z - 20))
    box = np.where(missing, 0, whole).astype(np.uint8)
    found, family = find_family(box, NAMES, SPACING)
    assert any("lcca touches aorta by" in note for note in family.notes)
    assert (found[missing] == LCCA).mean() > 0.9
    unchanged, family = find_family(whole, NAMES, SPACING)
    assert family.notes == []
    np.testing.assert_array_equal(unchanged, whole)


def test_nothing_is_led_on_over_a_long_gap_or_if_the_vessel_is_too_narrow() -> None:
    for gap, least in ((14, 0.0), (2, 5e-3)):
        _, box = slanted(gap)
        before = box.copy()
        ours, theirs = (np.argwhere(box == number) * SPACING for number in (LCCA, AORTA))
        assert led_on(box, LCCA, ours, theirs, SPACING, least) is None
        np.testing.assert_array_equal(box, before)


def test_a_gap_in_a_wide_vessel_is_closed_over_its_whole_section() -> None:
    x, y, z = np.meshgrid(*[np.arange(n) for n in (30, 30, 70)], indexing="ij")
    aside = np.hypot(x - 15, y - 15)
    box = np.where(aside < 9, np.uint8(AORTA), np.uint8(0))
    width = 3 + 0.15 * (x - 6)  # narrowest on one side
    box[np.abs(z - 35) < width / 2] = 0
    notes = clean_parts(box, NAMES, SPACING)
    assert any("in aorta is closed" in note for note in notes)
    assert (box[(aside < 6) & (np.abs(z - 35) < 20)] == AORTA).mean() > 0.99


FAMILY_NAMES = ("aorta", "bca", "lcca")
SHAPE = (60, 60, 90)


def tube(start: tuple[float, ...], end: tuple[float, ...], radius: float) -> np.ndarray:
    """Voxels whose middle lies within a radius of a segment, voxels."""
    points = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1).astype(float)
    a, b = np.array(start), np.array(end)
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - (a + along[..., None] * (b - a)), axis=-1) <= radius)


def boxed(*tubes: np.ndarray) -> np.ndarray:
    """The first vessel has what lies in several."""
    box = np.zeros(SHAPE, np.uint8)
    for number, one in reversed(list(enumerate(tubes, 1))):
        box[one] = number
    return box


FAMILY_AORTA = tube((12, 0, 30), (12, 59, 30), 10)
BCA = tube((12, 15, 30), (12, 15, 80), 6)


def test_a_carotid_that_runs_along_the_aorta_leaves_the_trunk_whose_side_it_begins_at() -> None:
    # it begins in the trunk's side, touches the aorta for a while, and turns up
    carotid = tube((12, 15, 44), (12, 45, 43), 3) | tube((12, 45, 43), (12, 50, 85), 3)
    _, family = find_family(boxed(FAMILY_AORTA, BCA, carotid), FAMILY_NAMES, SPACING)
    assert family.links[3].parent == 2
    assert [(a, b) for a, b, _ in family.false] == [(1, 3)]  # parted again
    assert not family.notes


def test_a_carotid_that_begins_where_both_lie_is_noted() -> None:
    carotid = tube((12, 15, 42), (12, 26, 42), 3) | tube((12, 26, 42), (12, 40, 85), 3)
    _, family = find_family(boxed(FAMILY_AORTA, BCA, carotid), FAMILY_NAMES, SPACING)
    assert family.links[3].parent == 1
    assert family.notes == ["lcca begins at aorta and bca, and is taken to leave aorta"]
    assert family.false == []


def test_an_aorta_that_a_branch_parts_keeps_both_its_ends() -> None:
    points = np.arange(41)[:, None] * [0.0, 0.0, 1e-3]
    pairs = np.stack([np.arange(40), np.arange(1, 41)], axis=1)
    depth = np.full(41, 5e-3)
    depth[5] = 9e-3
    graph = LumenGraph(points, depth, np.arange(41), pairs, np.full(40, 1e-3), 1e-3)
    mine = np.ones(41, dtype=np.bool_)
    assert set(paths._far_ends(graph, mine)) == {0, 40}
    mine[18:23] = False  # the nodes of a branch as wide as the aorta is there
    assert set(paths._far_ends(graph, mine)) == {0, 40}


def two_slabs(apart: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A vessel of two slabs of 6 x 3 voxels, one above the other's end, and the voxels of the first."""
    mask = np.zeros((60, 12, 12), dtype=bool)
    mask[2:30, 3:9, 2:5] = True
    kept = mask.copy()
    mask[29:55, 3:9, 5 + apart : 8 + apart] = True
    return mask, kept


def test_a_way_leads_over_the_step_to_the_far_end() -> None:
    mask, kept = two_slabs()
    (way,) = ways_to_lost(mask, kept, SPACING)
    voxels = np.rint(way / SPACING).astype(int)
    assert mask[tuple(voxels.T)].all()
    assert kept[tuple(voxels[0])]
    assert voxels[-1][0] == 54
    assert np.abs(np.diff(voxels, axis=0)).max() == 1


def test_no_way_where_nothing_is_lost_or_nothing_hangs_together() -> None:
    mask, kept = two_slabs()
    assert ways_to_lost(mask, mask, SPACING) == []
    without_few = mask.copy()
    without_few[54, 3:9, 5:8] = False
    assert ways_to_lost(mask, without_few, SPACING) == []
    assert ways_to_lost(*two_slabs(apart=2), SPACING) == []
    mask[29:, 3:9, 5:8] = False  # a bar alone hangs on it
    mask[25:55, 5, 5:7] = True
    assert ways_to_lost(mask, kept, SPACING) == []
