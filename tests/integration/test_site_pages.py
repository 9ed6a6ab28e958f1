"""The site: links, the notebook, entries of every module."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.integration.documents.pages import DOCS, PROJECT_ROOT, read, require_imports


@pytest.fixture(scope="module")
def site() -> ModuleType:
    specification = importlib.util.spec_from_file_location("site_pages", DOCS / "site_pages.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("page", "link", "expected"),
    [
        ("about.md", "![film](docs/pictures/navigation.gif)", "![film](pictures/navigation.gif)"),
        ("about.md", "see [examples/](examples) and [MIT](LICENSE)", "see examples/ and MIT"),
        ("cathsim/many_anatomies.md", "[r](../../packages/cathsim/README.md)", "[r](../packages/cathsim.md)"),
        ("packages/enn.md", "[p](../../docs/enn/policies.md#x)", "[p](../enn/policies.md#x)"),
        ("tutorial.md", "![output](tutorial_0.png)", "![output](tutorial_0.png)"),
        ("models.md", "[c](../packages/guide3d/src/guide3d/weights/reader.md)", "[c](models/reader.md)"),
        ("index.md", "[n](tutorial.ipynb)", "[n](tutorial.md)"),
        ("index.md", "[w](https://example.org/x.md)", "[w](https://example.org/x.md)"),
    ],
)
def test_links_lead_to_pages_of_the_site(site: ModuleType, page: str, link: str, expected: str) -> None:
    assert site.with_links_of_the_site(link, page) == expected


def test_the_notebook_becomes_a_page_with_its_pictures(site: ModuleType) -> None:
    text, pictures = site.notebook_page(json.loads((DOCS / "tutorial.ipynb").read_text(encoding="utf-8")))
    assert list(pictures) == ["tutorial_0.png", "tutorial_1.png"]
    assert all(picture.startswith(b"\x89PNG") for picture in pictures.values())
    assert "![output](tutorial_1.png)" in text
    assert "reached after" in text


def test_every_module_has_an_entry_among_the_interfaces(site: ModuleType) -> None:
    pages = dict(site.api_pages())
    assert {"api/cathsim.md", "api/enn.md", "api/guide3d.md", "api/splineformer.md"} <= set(pages)
    assert "::: cathsim.environment\n" in pages["api/cathsim.md"]
    assert "[goals](cathsim/goals.md)" in pages["api/cathsim.md"]
    assert "::: guide3d.geometry.camera\n" in pages["api/guide3d/geometry.md"]
    assert not [page for page, text in pages.items() if "::: " not in text]


@pytest.mark.slow
def test_the_site_is_built_strictly(tmp_path: Path) -> None:
    pytest.importorskip("mkdocstrings", reason="make docs installs MkDocs")
    # without Ruff, which would be started for each of 2,000 signatures to set its lines
    program = "import sys; sys.modules['ruff'] = None; from mkdocs.__main__ import cli; cli()"
    done = subprocess.run(
        [sys.executable, "-c", program, "build", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=PROJECT_ROOT, capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip
    assert done.returncode == 0, (done.stdout + done.stderr)[-2000:]
    assert "NavigateEnv" in (tmp_path / "site" / "api" / "cathsim.html").read_text(encoding="utf-8")
    assert (tmp_path / "site" / "tutorial_1.png").stat().st_size > 10_000


BENCHMARKS = PROJECT_ROOT / "benchmarks"


@pytest.mark.parametrize("file", sorted(BENCHMARKS.rglob("*.py")), ids=lambda file: str(file.relative_to(BENCHMARKS)))
def test_what_a_benchmark_imports_is_there(file: Path) -> None:
    require_imports(read(file))
