"""The six branching types of the aortic arch, as data: which vessels leave where.

Source: as of `courses`. The types I, II, IV, V, VI and VII are those of its generator; the numbering is the usual one
of radiology, in which type III is left out here as there.
"""

from __future__ import annotations

from typing import NamedTuple

from cathsim.anatomy.generator.variety.courses import Spread

CAROTID_TRUNK, SUBCLAVIAN_TRUNK = "carotid_trunk", "subclavian_trunk"
TRUNKS = ("bca", CAROTID_TRUNK, SUBCLAVIAN_TRUNK)


class Origin(NamedTuple):
    """A vessel and where it leaves its parent."""

    vessel: str
    course: str  # a key of `courses.COURSES`
    # of the aorta: mm along its centreline from the origin before, or from the root; of a trunk: share of its length
    place: Spread
    parent: str = "aorta"


_END: Spread = (1.0, 0.0)
_RIGHT_PAIR = (
    Origin("rsa", "right_subclavian_of_trunk", _END, "bca"),
    Origin("rcca", "right_carotid_of_trunk", _END, "bca"),
)
_CAROTID_PAIR = (
    Origin("rcca", "right_carotid_of_carotid_trunk", _END, CAROTID_TRUNK),
    Origin("lcca", "left_carotid_of_trunk", _END, CAROTID_TRUNK),
)

# of each type the variants, equally likely; of each variant the vessels in order from the aortic root
BRANCHING: dict[str, tuple[tuple[Origin, ...], ...]] = {
    "I": (
        (
            Origin("bca", "trunk", (36, 5)),
            *_RIGHT_PAIR,
            Origin("lcca", "left_carotid", (16, 4)),
            Origin("lsa", "left_subclavian", (28, 3)),
        ),
    ),
    "II": (
        (
            Origin("bca", "trunk", (36, 3)),
            *_RIGHT_PAIR,
            Origin("lcca", "left_carotid_of_trunk", (2 / 3, 0.1), "bca"),
            Origin("lsa", "left_subclavian", (41, 2.5)),
        ),
    ),
    "IV": (
        (
            Origin("rsa", "right_subclavian_first", (42, 5)),
            Origin(CAROTID_TRUNK, "wide_trunk", (20, 4)),
            Origin("rcca", "right_carotid_of_trunk", _END, CAROTID_TRUNK),
            Origin("lcca", "left_carotid_of_trunk", _END, CAROTID_TRUNK),
            Origin("lsa", "left_subclavian_low", (38, 3)),
        ),
    ),
    "V": (
        (
            Origin(CAROTID_TRUNK, "trunk", (36, 3)),
            *_CAROTID_PAIR,
            Origin("lsa", "left_subclavian", (41, 2.5)),
            Origin("rsa", "right_subclavian_last", (20, 1)),
        ),
        (
            Origin("rcca", "right_carotid", (50, 2.5)),
            Origin("lcca", "left_carotid", (22, 3)),
            Origin("lsa", "left_subclavian", (26, 2.5)),
            Origin("rsa", "right_subclavian_last", (20, 1)),
        ),
    ),
    "VI": (
        (
            Origin(CAROTID_TRUNK, "trunk", (36, 3)),
            *_CAROTID_PAIR,
            Origin(SUBCLAVIAN_TRUNK, "wide_trunk", (50, 1.5)),
            Origin("rsa", "right_subclavian_of_subclavian_trunk", _END, SUBCLAVIAN_TRUNK),
            Origin("lsa", "left_subclavian_of_trunk", _END, SUBCLAVIAN_TRUNK),
        ),
    ),
    "VII": (
        (
            Origin("rsa", "right_subclavian_first", (38, 3.5)),
            Origin("rcca", "right_carotid", (20, 3)),
            Origin("lcca", "left_carotid", (20, 3)),
            Origin("lsa", "left_subclavian", (27, 3)),
        ),
    ),
}
ARCH_TYPES: tuple[str, ...] = tuple(BRANCHING)
