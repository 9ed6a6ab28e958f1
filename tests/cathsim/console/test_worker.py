"""The real-time loop: pace, first touch, end, replay, choice, and an operator who leaves."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from cathsim.console.operator_setup import Setup
from cathsim.console.questionnaire import CRITERIA
from cathsim.console.worker import RealTimeLoop

Wait = Callable[..., Any]
ANSWERS = {criterion.key: 5 for criterion in CRITERIA}


@pytest.fixture
def loop(page: Any, memory: Any) -> Iterator[RealTimeLoop]:
    loop = RealTimeLoop(Setup(accuracy="fast", max_steps=6), page, memory, note="somewhere")
    loop.start()
    loop.operator_came()
    yield loop
    loop.stop()
    assert not loop.is_alive()


def hold(loop: RealTimeLoop, sequence: int, advance: float = 1.0) -> None:
    loop.request({"type": "controls", "advance": advance, "rotate": 0.0, "sequence": sequence})


def finish(loop: RealTimeLoop, page: Any, wait_until: Wait) -> None:
    """Holds the key, as the page's heartbeat does, until the procedure has ended."""

    def held() -> Any:
        hold(loop, 3)
        return page.messages_of("ended")

    wait_until(held)


def test_a_procedure_waits_for_the_operator_runs_in_real_time_and_is_replayed(
    loop: RealTimeLoop, page: Any, memory: Any, wait_until: Wait
) -> None:
    task = wait_until(lambda: page.messages_of("task"))[0]
    assert (task["phantom"], task["target"], task["recording"]) == ("type_1", "bca", "somewhere")
    assert {"bca", "lcca", "lsa"} <= set(task["targets"])
    assert all(0 < x < task["size"] for x in task["views"]["a"]["mark"]["pixel"])
    assert 5 < task["views"]["a"]["mark"]["radius"] < 60
    assert page.surfaces == 1
    wait_until(lambda: len(page.headers) > 5)
    assert {(header["state"], header["step"]) for header in page.headers} == {("ready", 0)}
    assert memory.episodes[0]["actions"] == []
    loop.request({"type": "replay"})
    wait_until(lambda: page.messages_of("notice"))
    assert "finish a procedure first" in page.messages_of("notice")[0]["text"]
    hold(loop, 3)
    wait_until(lambda: page.last["state"] == "running")
    finish(loop, page, wait_until)
    wait_until(lambda: page.last["state"] == "ended")
    running = [k for k, header in enumerate(page.headers) if header["state"] == "running"]
    assert len(running) == 3 * 5, "the sixth step ends the procedure"
    assert page.headers[running[0]]["sequence"] == 3, "the first picture already shows the touch"
    assert len({round(page.headers[k]["time_s"], 6) for k in running}) == len(running)
    # never faster than real time; slower only on a machine that does not keep up
    assert page.times[running[-1]] - page.times[running[0]] > 0.9 * (len(running) - 1) / 30
    assert len(memory.episodes[0]["actions"]) == 6
    ended = page.messages_of("ended")
    assert len(ended) == 1
    assert (ended[0]["success"], ended[0]["recorded"]) == (False, "0.memory")
    assert ended[0]["metrics"]["steps"] == 6
    loop.request({"type": "replay"})
    wait_until(lambda: page.messages_of("replayed"))
    shown = [header for header in page.headers if header["state"] == "replay"]
    assert shown[0]["time_s"] == 0
    assert shown[-1]["time_s"] == pytest.approx(0.6)
    assert shown[-1]["insertion_mm"] == page.last["insertion_mm"]
    assert (np.diff([header["insertion_mm"] for header in shown]) >= 0).all()
    loop.request({"type": "answers", "answers": ANSWERS})
    wait_until(lambda: page.messages_of("saved"))
    assert memory.episodes[0]["answers"] == {**ANSWERS, "participant": ""}


def test_an_operator_who_leaves_lets_go_and_the_latest_choices_count(
    loop: RealTimeLoop, page: Any, memory: Any, wait_until: Wait
) -> None:
    hold(loop, 1)
    wait_until(lambda: page.last["step"] >= 2)
    loop.operator_left()
    wait_until(lambda: len(memory.episodes) == 2)
    assert memory.episodes[0]["state"] == "broken off"
    assert wait_until(lambda: page.last["state"] == "ready")
    assert not loop.panel.touched
    loop.request({"type": "choose", "phantom": "type_1", "target": "lcca"})
    wait_until(lambda: page.messages_of("task")[-1]["target"] == "lcca")
    assert page.surfaces == 1, "the same vessel is not sent again"
    loop.request({"type": "choose", "phantom": "type_1", "target": "nowhere"})
    wait_until(lambda: len(page.messages_of("task")) == 3)
    assert page.messages_of("task")[-1]["target"] in page.messages_of("task")[0]["targets"]
    with pytest.raises(ValueError, match="unknown phantom 'moon'"):
        loop.request({"type": "choose", "phantom": "moon", "target": "bca"})
    with pytest.raises(ValueError, match="answers should be a valid dictionary"):
        loop.request({"type": "answers", "answers": [1, 2]})
    for number in range(1000):
        loop.request({"type": "restart"})
        loop.request({"type": "choose", "phantom": "type_1", "target": "lcca" if number == 999 else "bca"})
        hold(loop, number)
        assert len(loop._inbox) <= 4
    loop.request({"type": "release"})
    assert not loop.panel.touched, "a release is obeyed at once, whatever waits"
    wait_until(lambda: page.messages_of("task")[-1]["target"] == "lcca")


def test_a_catheter_is_chosen_steered_and_left_out(
    loop: RealTimeLoop, page: Any, memory: Any, wait_until: Wait
) -> None:
    task = wait_until(lambda: page.messages_of("task"))[0]
    assert (task["catheter"], task["devices"]) == (None, 1)
    assert {"name": "simmons2_6f", "shape": "simmons2", "french": 6} in task["catheters"]
    steer = {"type": "controls", "advance": 1.0, "rotate": 0.0, "sequence": 1, "catheter": [1.0, 0.5]}
    choice = {"type": "choose", "phantom": "type_1", "target": "bca"}
    with pytest.raises(ValueError, match="there is no catheter to steer"):
        loop.request(steer)
    with pytest.raises(ValueError, match="unknown catheter 'moon'"):
        loop.request({**choice, "catheter": "moon"})
    with pytest.raises(ValueError, match=r"unknown catheter '/etc/moon\.yaml'"):
        loop.request({**choice, "catheter": "/etc/moon.yaml"})
    loop.request({**choice, "catheter": "vertebral"})
    task = wait_until(lambda: page.messages_of("task")[1:])[0]
    assert (task["catheter"], task["devices"], page.surfaces) == ("vertebral_5f", 2, 1)

    def ended() -> Any:
        loop.request(steer)
        return page.messages_of("ended")

    wait_until(ended)
    last = wait_until(lambda: page.last["state"] == "ended" and page.last)
    np.testing.assert_array_equal(memory.episodes[-1]["actions"], [[1.0, 0.0, 1.0, 0.5]] * 6)
    assert last["catheter_insertion_mm"] > 10
    assert last["lead_mm"] == pytest.approx(last["insertion_mm"] - last["catheter_insertion_mm"])
    assert last["catheter_rotation_rad"] == pytest.approx(6 * 0.5 * np.radians(15))
    assert len(last["feeder_forces_n"]) == 2
    assert last["catheter_points"] > 10
    loop.request({**choice, "target": "lcca"})
    task = wait_until(lambda: page.messages_of("task")[2:])[0]
    assert (task["target"], task["catheter"]) == ("lcca", "vertebral_5f"), "what is not chosen stays"
    loop.request({**choice, "catheter": None})
    assert wait_until(lambda: page.messages_of("task")[3:])[0]["devices"] == 1
    wait_until(lambda: "lead_mm" not in page.last)


def test_what_a_request_runs_into_is_told_and_the_loop_goes_on(
    loop: RealTimeLoop, page: Any, memory: Any, wait_until: Wait, monkeypatch: pytest.MonkeyPatch
) -> None:
    finish(loop, page, wait_until)
    refuse = "a wire of 1.20 mm does not pass a catheter with a lumen of 1.03 mm"

    def refused(*arguments: Any) -> None:
        raise ValueError(refuse)

    monkeypatch.setattr(Setup, "environment", refused)
    loop.request({"type": "choose", "phantom": "type_1", "target": "bca", "catheter": "straight_4f"})
    wait_until(lambda: [notice for notice in page.messages_of("notice") if notice["text"] == refuse])
    task = page.messages_of("task")[-1]
    assert (task["catheter"], task["replayable"]) == (None, True)
    assert len(memory.episodes) == 1
    monkeypatch.undo()

    for request in ({"type": "choose", "phantom": "type_1", "target": 5}, {"type": "choose"}, {"type": 5}, {}):
        with pytest.raises(ValueError, match="request"):
            loop.request(request)

    def broken(*arguments: Any) -> None:
        raise KeyError("nothing of that name")

    monkeypatch.setattr(loop, "_choose", broken)
    loop.request({"type": "choose", "phantom": "type_1", "target": "lcca"})
    wait_until(lambda: [n for n in page.messages_of("notice") if "'choose' failed (KeyError" in n["text"]])
    monkeypatch.setattr(loop, "_next_picture", broken)
    wait_until(lambda: [n for n in page.messages_of("notice") if "it starts again" in n["text"]])
    monkeypatch.setattr(loop, "_restart", broken)
    time.sleep(0.1)
    monkeypatch.undo()
    page.messages.clear()
    loop.request({"type": "restart"})
    finish(loop, page, wait_until)
    assert loop.is_alive()


def test_c_arms_pedal_contrast_and_roadmap(loop: RealTimeLoop, page: Any, wait_until: Wait) -> None:
    first = wait_until(lambda: page.messages_of("task"))[0]["views"]
    assert (first["a"]["primary_deg"], first["b"]["primary_deg"]) == (0.0, 90.0)
    for zoom in (1.0, 2.0):  # only the latest counts
        loop.request({"type": "view", "camera": "b", "primary_deg": -30.0, "secondary_deg": 10.0, "zoom": zoom})
    views = wait_until(lambda: [m for m in page.messages_of("views") if m["views"]["b"]["zoom"] == 2.0])[-1]["views"]
    assert (views["b"]["primary_deg"], views["b"]["secondary_deg"]) == (-30.0, 10.0)
    assert views["a"] == first["a"]
    with pytest.raises(ValueError, match="secondary_deg should be"):
        loop.request({"type": "view", "camera": "a", "primary_deg": 0.0, "secondary_deg": 80.0, "zoom": 1.0})
    loop.request({"type": "inject"})
    wait_until(lambda: page.last["contrast"] > 0.9)
    assert page.last["injections"] == 1
    loop.request({"type": "roadmap", "on": True})
    wait_until(lambda: page.last["roadmap"])
    loop.request({"type": "pedal", "on": False})
    wait_until(lambda: not page.last["beam"])
    finish(loop, page, wait_until)
    ended = page.messages_of("ended")[0]
    assert (ended["dose_s"], ended["injections"], ended["compared"]) == (0.0, 1, False)
    loop.request({"type": "pedal", "on": True})
    loop.request({"type": "restart"})
    wait_until(lambda: page.last["state"] == "ready" and page.last["injections"] == 0)
    hold(loop, 9)
    wait_until(lambda: page.last["dose_s"] > 0.2)


def test_success_radius_and_force_limit_are_chosen_and_count(
    loop: RealTimeLoop, page: Any, memory: Any, wait_until: Wait
) -> None:
    task = wait_until(lambda: page.messages_of("task"))[0]
    assert (task["success_radius_mm"], task["force_limit_n"], task["ends_at_force_limit"]) == (8.0, 2.0, False)
    choice = {"type": "choose", "phantom": "type_1", "target": "bca", "max_steps": 40}
    loop.request({**choice, "success_radius_mm": 15, "force_limit_n": 1e-6, "ends_at_force_limit": True})
    chosen = wait_until(lambda: page.messages_of("task")[1:])[0]
    assert chosen["success_radius"] == pytest.approx(0.015)
    assert chosen["views"]["a"]["mark"]["radius"] == pytest.approx(task["views"]["a"]["mark"]["radius"] * 15 / 8)
    finish(loop, page, wait_until)
    ended = page.messages_of("ended")[0]
    assert (ended["success"], ended["stopped"], ended["force_warnings"]) == (False, True, 1)
    assert ended["metrics"]["steps"] == len(memory.episodes[-1]["actions"]) < 40
    assert ended["dose_s"] == pytest.approx(0.1 * ended["metrics"]["steps"]), "the beam was on in every step"
    loop.request({**choice, "ends_at_force_limit": False, "max_steps": 6})
    again = wait_until(lambda: page.messages_of("task")[2:])[0]
    assert (again["success_radius_mm"], again["force_limit_n"]) == (15.0, 1e-6), "what is not chosen stays"
    for wrong in ({"success_radius_mm": 0}, {"success_radius_mm": 80}, {"force_limit_n": 0}, {"force_limit_n": "2"}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))} should be"):
            loop.request({**choice, **wrong})


def test_the_page_is_told_how_far_the_expert_is_and_its_score(
    page: Any, wait_until: Wait, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = RealTimeLoop(Setup(accuracy="fast", max_steps=4), page, compared=True)
    loop.start()
    loop.operator_came()
    wait_until(lambda: page.headers)
    finish(loop, page, wait_until)
    progress = wait_until(lambda: page.messages_of("expert_progress"), 120)[0]
    assert 1 <= progress["steps"] <= 4
    score = wait_until(lambda: page.messages_of("expert"), 60)[0]["score"]
    assert (score["success"], score["metrics"]["steps"]) == (False, 4)
    loop.request({"type": "restart"})
    wait_until(lambda: page.last["state"] == "ready")
    page.messages.clear()
    finish(loop, page, wait_until)
    assert page.messages_of("ended")[0]["expert"] == score, "it is known from the procedure before"
    loop.stop()
