"""Where the project lives is said once, in pyproject.toml; every other place agrees with it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

from tests.integration.documents.pages import DOCUMENTS, PACKAGES, PROJECT_ROOT, read, relative

PLACEHOLDER = re.compile(r"https?://example\.invalid[^\s>)\"'`]*")


def urls(pyproject: Path) -> dict[str, str]:
    declared: dict[str, str] = tomllib.loads(read(pyproject))["project"]["urls"]
    return declared


DECLARED = urls(PROJECT_ROOT / "pyproject.toml")


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_name_the_same_addresses(package: str) -> None:
    assert urls(PROJECT_ROOT / "packages" / package / "pyproject.toml") == DECLARED


def test_readme_and_citation_name_the_addresses() -> None:
    assert DECLARED.keys() == {"Repository", "Issues"}
    assert all(f"<{address}>" in read(PROJECT_ROOT / "README.md") for address in DECLARED.values())
    assert yaml.safe_load(read(PROJECT_ROOT / "CITATION.cff"))["repository-code"] == DECLARED["Repository"]


@pytest.mark.parametrize("document", [*DOCUMENTS, PROJECT_ROOT / "CITATION.cff"], ids=relative)
def test_no_document_has_an_address_of_before(document: Path) -> None:
    assert set(PLACEHOLDER.findall(read(document))) <= set(DECLARED.values())
