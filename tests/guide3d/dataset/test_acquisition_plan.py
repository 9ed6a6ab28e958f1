"""Acquisition plan: the thesis's composition, and acquisitions named once."""

from guide3d.dataset.acquisition_split import COMPOSITION, composition, plan_acquisitions


def test_composition_is_the_thesiss() -> None:
    assert composition(8746) == {kind: count // 2 for kind, count in COMPOSITION.items()}
    for images in (8, 40, 2400):
        counts = composition(images)
        assert sum(counts.values()) == images // 2
        assert min(counts.values()) >= 1
    assert composition(2400)[True, "angled"] == round(1200 * 3664 / 8746)


def test_a_plan_names_every_acquisition_once_and_repeats_itself() -> None:
    plan = plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"])
    assert len({one.name for one in plan}) == len(plan)
    assert sum(one.pairs for one in plan) == 1200
    assert max(one.pairs for one in plan) <= 13
    assert {one.target for one in plan} == {"bca", "lsa"}
    assert {one.phantom for one in plan} == {"type_1", "type_2"}
    assert plan == plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"])
