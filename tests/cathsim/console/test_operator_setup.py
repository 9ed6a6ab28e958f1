"""What the operator may choose: what is left out stays, what there is not is refused."""

from pathlib import Path

import pytest

from cathsim.console.operator_setup import (
    OWN,
    OWN_WIRE,
    Choices,
    ForceLimit,
    ForceWatch,
    Setup,
    find_offer,
    offered,
)

ASKED = {"type": "choose", "phantom": "type_2", "target": "lcca"}


def test_what_is_left_out_stays_as_it_is() -> None:
    setup = Setup(wire="stiff", catheter="vertebral", max_steps=99, success_radius=0.01, force_limit=ForceLimit(3.0))
    choices = Choices(setup, ("type_1", "type_2"))
    chosen = choices.read(ASKED, setup, choices.first_catheter)
    assert (chosen.setup, chosen.phantom, chosen.target) == (setup, "type_2", "lcca")
    assert chosen.catheter is choices.first_catheter
    without = choices.read({**ASKED, "catheter": None, "ends_at_force_limit": True}, setup, choices.first_catheter)
    assert without.catheter is None
    assert without.setup.force_limit == ForceLimit(3.0, ends=True)


def test_limits_are_told_and_read_in_the_pages_units() -> None:
    choices = Choices(Setup(), ("type_1", "type_2"))
    asked = {**ASKED, "success_radius_mm": 12.5, "force_limit_n": 0.5, "max_steps": 60}
    chosen = choices.read(asked, Setup(), None)
    assert chosen.setup.success_radius == pytest.approx(0.0125)
    told = choices.to_page(chosen.setup, None)
    assert (told["success_radius_mm"], told["force_limit_n"], told["max_steps"]) == (12.5, 0.5, 60)
    assert chosen.setup.task("type_2", "lcca", None)["most_force"] is None
    assert Setup(force_limit=ForceLimit(0.5, ends=True)).task("type_2", "lcca", None)["most_force"] == 0.5


def test_a_wire_of_ones_own_is_offered_without_its_path(tmp_path: Path) -> None:
    setup = Setup(wire=str(tmp_path / "mine.yaml"))
    choices = Choices(setup, ("type_1", "type_2"))
    told = choices.to_page(setup, None)
    assert (told["wire"], told["wires"][0]) == (OWN_WIRE, OWN_WIRE)
    assert str(tmp_path) not in str(told)
    other = choices.read({**ASKED, "wire": "stiff"}, setup, None).setup
    assert choices.read({**ASKED, "wire": OWN_WIRE}, other, None).setup.wire == setup.wire


@pytest.mark.parametrize("wire", ["/etc/x.yaml", OWN_WIRE])
def test_a_wire_that_is_not_offered_is_refused(wire: str) -> None:
    with pytest.raises(ValueError, match="unknown wire"):
        Choices(Setup(), ("type_1", "type_2")).read({**ASKED, "wire": wire}, Setup(), None)


def test_ones_own_file_comes_first_and_by_no_path() -> None:
    offers = offered("/somewhere/mine.yaml")
    assert (offers[0].name, offers[0].shape, offers[0].french) == (OWN, "mine", None)
    assert find_offer(offers, OWN).source == find_offer(offers, "/somewhere/mine.yaml").source == "/somewhere/mine.yaml"
    assert "somewhere" not in str(offers[0].to_page())


def test_each_rise_to_the_limit_is_one_warning() -> None:
    watch = ForceWatch(ForceLimit(2.0))
    assert [watch.see(force) for force in (0.5, 2.0, 3.0, 1.9, 2.5)] == [False, True, False, False, True]
    assert (watch.warnings, watch.ends) == (2, False)


@pytest.mark.parametrize("wrong", [0.0, 101.0, float("nan")])
def test_impossible_limits_are_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="force must"):
        ForceLimit(wrong)


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"seed": 2**70}, {"max_steps": 0}, {"max_steps": 10**9}], ids=str)
def test_a_setup_that_cannot_be_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} must lie in"):
        Setup(**wrong)  # type: ignore[arg-type]
