"""Parts of labels: gaps, specks, holes, and parts that go on from another vessel."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy.volume.labels.family import find_family
from cathsim.anatomy.volume.labels.parts import clean_parts, led_on

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


def test_whole_labels_stay() -> None:
    box = arch()
    assert clean_parts(box, NAMES, SPACING) == []
    np.testing.assert_array_equal(box, arch())


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
    assert led is not None
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


def test_a_vessel_with_its_whole_section_at_its_parent_is_not_led_on() -> None:
    _, box = slanted(2)
    ours, theirs = (np.argwhere(box == number) * SPACING for number in (LCCA, AORTA))
    assert led_on(box.copy(), LCCA, ours, theirs, SPACING, most_share=0.1) is None
    assert led_on(box.copy(), LCCA, ours, theirs, SPACING, most_share=0.9) is not None


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
