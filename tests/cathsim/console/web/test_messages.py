"""What goes over the websocket, who is let in, and the questionnaire."""

import json
import struct

import numpy as np
import pytest

from cathsim.console import CRITERIA, check_answers
from cathsim.console.web.messages import LONGEST_REQUEST, Access, frame_message, read_request, surface_message

CONTROLS = '{"type": "controls", "advance": 1, "rotate": 0, "sequence": 1'
GOOD = {criterion.key: 3 for criterion in CRITERIA}


@pytest.mark.parametrize("state", ["ready", "running"])
def test_a_picture_is_read_back_as_the_page_reads_it(state: str) -> None:
    points = np.random.default_rng(0).normal(size=(29, 3))
    message = frame_message({"state": state, "step": 7}, points, b"\xff\xd8jpeg")
    length = struct.unpack_from("<I", message, 4)[0]
    assert message[:4] == b"FRME"
    assert length % 4 == 0, "JavaScript's float arrays begin at multiples of 4"
    header = json.loads(message[8 : 8 + length])
    assert header == {"state": state, "step": 7, "points": 29, "jpeg_bytes": [6]}
    read = np.frombuffer(message, "<f4", 3 * 29, 8 + length).reshape(-1, 3)
    np.testing.assert_array_equal(read, points.astype(np.float32))
    assert message[8 + length + 12 * 29 :] == b"\xff\xd8jpeg"


def test_a_surface_is_read_back() -> None:
    rng = np.random.default_rng(1)
    vertices, normals, faces = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), rng.integers(0, 5, (4, 3))
    message = surface_message(vertices, normals, faces)
    assert message[:4] == b"MESH"
    assert struct.unpack_from("<II", message, 4) == (5, 4)
    np.testing.assert_array_equal(np.frombuffer(message, "<f4", 15, 12).reshape(-1, 3), vertices.astype("<f4"))
    np.testing.assert_array_equal(np.frombuffer(message, "<f4", 15, 72).reshape(-1, 3), normals.astype("<f4"))
    np.testing.assert_array_equal(np.frombuffer(message, "<u4", 12, 132).reshape(-1, 3), faces)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "must be JSON"),
        ("[" * 10_000, "must be JSON"),
        ("[]", "needs a type"),
        ('{"type": ["x"]}', "needs a type"),
        ('{"type": "shutdown"}', "needs a type.*got 'shutdown'"),
        ('{"type": "controls", "advance": 1}', "'controls' needs the field rotate"),
        ('{"type": "restart", "more": 1}', "'restart' has no field more"),
        ('{"type": "choose", "phantom": "type_1", "target": [5]}', r"target should be a valid string, got \[5\]"),
        ('{"type": "controls", "advance": NaN, "rotate": 0, "sequence": 1}', "advance should be a finite number"),
        ('{"type": "controls", "advance": true, "rotate": 0, "sequence": 1}', "advance should be a valid number"),
        ('{"type": "controls", "advance": 1, "rotate": 0, "sequence": 1e30}', "sequence should be"),
        (f'{CONTROLS}, "catheter": [1, 0, 0, 1]}}', "catheter should have 2 numbers, got 4"),
        (f'{CONTROLS}, "catheter": [NaN, 0]}}', "catheter.0 should be a finite number"),
        (f'{CONTROLS}, "catheter": [0, true]}}', "catheter.1 should be a valid number"),
        (f'{CONTROLS}, "catheter": null}}', "catheter should be a valid array"),
        ('{"type": "choose", "phantom": "a", "target": "b", "catheter": 5}', "catheter should be a valid string"),
        ('{"type": "choose", "phantom": "a", "target": "b", "catheter": ""}', "catheter should have"),
        ('{"type": "answers", "answers": {"a": {"b": 1}}}', "answers"),
        ('{"type": "choose", "phantom": "\\ud800", "target": "bca"}', "must be JSON"),
        ('{"type": "restart"}' + " " * LONGEST_REQUEST, "may have 16384 characters"),
    ],
)
def test_other_requests_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_request(text)


def test_seven_criteria_are_answered_on_the_scale() -> None:
    assert len(CRITERIA) == 7
    answers = check_answers({**dict(reversed(GOOD.items())), "participant": " P1 "})
    assert list(answers) == [*(criterion.key for criterion in CRITERIA), "participant"]
    assert answers["participant"] == "P1"
    assert check_answers(GOOD)["participant"] == ""


def test_answers_off_the_scale_missing_and_unknown_criteria_are_refused() -> None:
    for wrong in (0, 6, 2.5, "3", True, None):
        with pytest.raises(ValueError, match="motion_accuracy must be a whole number from 1 to 5"):
            check_answers({**GOOD, "motion_accuracy": wrong})
    with pytest.raises(ValueError, match="visual_realism has none"):
        check_answers({key: value for key, value in GOOD.items() if key != "visual_realism"})
    with pytest.raises(ValueError, match="no criterion mood"):
        check_answers({**GOOD, "mood": 5})
    with pytest.raises(ValueError, match="participant must be a code"):
        check_answers({**GOOD, "participant": "x" * 41})


def test_own_pages_are_let_in_without_a_token_and_those_of_other_sites_not_even_with_it() -> None:
    for host in ("127.0.0.1:8000", "localhost:8000", "[::1]:8000"):
        assert Access().refusal({"host": host}, "") == ""
        assert Access().refusal({"host": host, "origin": f"http://{host}"}, "") == ""
    headers = {"host": "127.0.0.1:8000", "origin": "http://example.org"}
    for access in (Access(), Access("secret")):
        assert "other sites" in access.refusal(headers, "secret")
    assert "other sites" in Access().refusal({"host": "127.0.0.1:8000", "origin": "http://127.0.0.1:9000"}, "")
    assert "other sites" in Access().refusal({"host": "127.0.0.1:8000", "origin": "null"}, "")


def test_a_foreign_name_of_this_machine_is_refused() -> None:
    for host in ("rebound.example.org:8000", "", "["):
        with_origin = {"host": host, "origin": f"http://{host}"}
        assert Access().refusal({"host": host}, "") != ""
        assert Access().refusal(with_origin, "") != ""


def test_the_token_must_be_right() -> None:
    access, headers = Access("sécret"), {"host": "10.0.0.2:8000"}
    assert access.refusal(headers, "sécret") == ""
    for wrong in ("", "secret", "sécret "):
        assert "needs its token" in access.refusal(headers, wrong)
