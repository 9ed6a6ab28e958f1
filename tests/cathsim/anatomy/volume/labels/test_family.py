"""Which labelled vessel leaves which, on drawn boxes: a carotid of the arch, of a trunk, beside another vessel."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy.volume.labels.family import find_family, from_far_end

NAMES = ("aorta", "bca", "lcca")
SPACING = np.full(3, 1e-3)
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


AORTA = tube((12, 0, 30), (12, 59, 30), 10)
BCA = tube((12, 15, 30), (12, 15, 80), 6)


def test_a_carotid_that_runs_along_the_aorta_leaves_the_trunk_whose_side_it_begins_at() -> None:
    # it begins in the trunk's side, touches the aorta for a while, and turns up
    carotid = tube((12, 15, 44), (12, 45, 43), 3) | tube((12, 45, 43), (12, 50, 85), 3)
    _, family = find_family(boxed(AORTA, BCA, carotid), NAMES, SPACING)
    assert family.links[3].parent == 2
    assert [(a, b) for a, b, _ in family.false] == [(1, 3)]  # parted again
    assert not family.notes


def test_a_carotid_beside_the_trunk_leaves_the_arch() -> None:
    carotid = tube((12, 24, 30), (12, 24, 58), 3) | tube((12, 24, 58), (12, 40, 85), 3)
    box = boxed(AORTA, BCA, carotid)
    assert ((box[:, :-1] == 2) & (box[:, 1:] == 3)).any()  # they touch
    _, family = find_family(box, NAMES, SPACING)
    assert family.links[3].parent == 1


def test_a_carotid_that_begins_where_both_lie_is_noted() -> None:
    carotid = tube((12, 15, 42), (12, 26, 42), 3) | tube((12, 26, 42), (12, 40, 85), 3)
    _, family = find_family(boxed(AORTA, BCA, carotid), NAMES, SPACING)
    assert family.links[3].parent == 1
    assert family.notes == ["lcca begins at aorta and bca, and is taken to leave aorta"]
    assert family.false == []


def test_places_along_a_label_are_those_of_its_course() -> None:
    hook = tube((10, 10, 10), (10, 10, 70), 3) | tube((10, 10, 70), (40, 10, 70), 3)
    contacts = {1: np.array([[10e-3, 10e-3, 7e-3]]), 2: np.array([[14e-3, 10e-3, 40e-3]])}
    along, radius = from_far_end(hook, contacts, SPACING)
    assert along[1] == pytest.approx(90e-3, abs=8e-3)
    assert along[1] - along[2] == pytest.approx(30e-3, abs=5e-3)
    assert radius == pytest.approx(3e-3, rel=0.15)
    coarse, _ = from_far_end(np.repeat(np.repeat(hook, 2, axis=0), 2, axis=1), contacts, SPACING / (2, 2, 1))
    assert coarse[1] == pytest.approx(along[1], abs=3e-3)
