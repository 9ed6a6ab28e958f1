"""The branching types as data: every vessel has a course and a parent before it."""

import pytest

from cathsim.anatomy.generator.variety_arch import ARCH_TYPES, BRANCHING, COURSES, TRUNKS


def test_the_types():
    assert ARCH_TYPES == ("I", "II", "IV", "V", "VI", "VII")


@pytest.mark.parametrize("arch_type", ARCH_TYPES)
def test_every_type_feeds_both_arms_and_both_carotids(arch_type):
    for variant in BRANCHING[arch_type]:
        known = {"aorta"}
        for origin in variant:
            assert origin.course in COURSES
            assert origin.parent in known
            known.add(origin.vessel)
        assert known >= {"rsa", "rcca", "lcca", "lsa"}
        assert {origin.parent for origin in variant} - {"aorta"} == known & set(TRUNKS)  # no trunk ends blindly
