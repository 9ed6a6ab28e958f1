"""Who is let in: this machine's pages, or whoever knows the token; never another site's page."""

from __future__ import annotations

import pytest

from cathsim.console.web.requests import Access, is_loopback


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("127.0.0.8", True), ("::1", True), ("localhost", True), ("0.0.0.0", False),
     ("192.168.1.7", False), ("::", False), ("localhost.example.org", False), ("", False)],
)  # fmt: skip
def test_loopback_is_this_machine_alone(host: str, expected: bool) -> None:
    assert is_loopback(host) is expected


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost:8000", "[::1]:8000"])
def test_own_pages_are_let_in_without_a_token(host: str) -> None:
    assert Access().refusal({"host": host}, "") == ""
    assert Access().refusal({"host": host, "origin": f"http://{host}"}, "") == ""


def test_pages_of_other_sites_are_refused_even_with_the_token() -> None:
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
