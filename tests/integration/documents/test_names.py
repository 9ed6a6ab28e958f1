"""Names, links, addresses, commands and settings in the documents are there."""

import importlib
import importlib.util
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.integration.documents.pages import (
    DOCS,
    DOCUMENTS,
    DOTTED,
    PACKAGES,
    PAGES,
    PROJECT_ROOT,
    STAGES,
    code_blocks,
    documents,
    quoted,
    read,
    relative,
    require_imports,
    resolves,
    without_blocks,
)

FOLDERS = ("pipeline/", "packages/", "benchmarks/", "tests/", "conf/", "docs/", "examples/")
# Groups of entry points, which look like modules and are none.
ENTRY_POINTS = {"cathsim.recorders"}


def run_settings() -> set[str]:
    """Names such as ``guide3d.root``, which are settings of a run and look like modules."""
    from pipeline.config import RunConfig

    source = RunConfig.__dataclass_fields__["guide3d"].default_factory
    return {f"guide3d.{name}" for name in source.__dataclass_fields__}


def anchors(text: str) -> set[str]:
    """The anchors that a Markdown renderer gives the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", without_blocks(text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@documents
def test_links_lead_to_files_and_headings(document: Path) -> None:
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", without_blocks(read(document))):
        if link.startswith(("http://", "https://")):
            continue
        path, _, anchor = link.partition("#")
        target = (document.parent / path).resolve() if path else document
        if not target.exists() or (anchor and anchor not in anchors(read(target))):
            wrong.append(link)
    assert not wrong


@documents
def test_dotted_names_exist(document: Path) -> None:
    settings = run_settings() | ENTRY_POINTS
    names = {found[0] for text in quoted(read(document)) if (found := DOTTED.match(text))}
    assert not sorted(name for name in names - settings if not resolves(name))


def paths_in(text: str) -> Iterator[str]:
    for item in [*quoted(text), *re.findall(r"\S+", "\n".join(code_blocks(text)))]:
        if item.startswith(FOLDERS) and not re.search(r"[<>…\[\]]", item):
            yield item.split(":")[0].rstrip(",.")


@pytest.mark.parametrize("document", [one for one in DOCUMENTS if one.name != "CHANGELOG.md"], ids=relative)
def test_paths_exist(document: Path) -> None:
    missing = []
    for path in paths_in(read(document)):
        choices = re.search(r"\{([^}]+)\}", path)
        variants = [path.replace(choices[0], one) for one in choices[1].split(",")] if choices else [path]
        missing += [one for one in variants if not any(PROJECT_ROOT.glob(one.rstrip("/")))]
    assert not missing


@documents
def test_commands_name_modules_files_and_verbs(document: Path) -> None:
    text = read(document)
    commands = "\n".join([*quoted(text), *code_blocks(text)])
    for module in re.findall(r"-m ((?:cathsim|enn|guide3d|splineformer|pipeline|tests)[\w.]*)", commands):
        assert module in sys.modules or importlib.util.find_spec(module), module  # guide3d.read stands for a function
    for script in re.findall(r"python ((?!-)\S+\.py)", commands):
        assert (PROJECT_ROOT / script).is_file(), script
    verbs = set(re.findall(r"^([a-z][a-z0-9_-]*):", read(PROJECT_ROOT / "Makefile"), re.MULTILINE)) | STAGES
    for verb in re.findall(r"(?:^|`)make ([a-z][a-z0-9_-]*)", commands, re.MULTILINE):
        assert verb in verbs, verb


def sources_of(command: str) -> str:
    """The sources in which the options of a command are declared: of a script, or of a module's package."""
    if script := re.search(r"python (\S+\.py)", command):
        return read(PROJECT_ROOT / script[1])
    module = re.search(r"-m ((?:cathsim|enn|guide3d|splineformer|pipeline|tests\.fuzz)\b[\w.]*)", command)
    if not module:
        return ""
    name = module[1] if "fuzz" in module[1] else module[1].split(".")[0]
    names = [name, "guide3d"] if name == "splineformer" else [name]  # whose options of a training it shares
    folders = [folder for one in names for folder in importlib.import_module(one).__path__]
    return "".join(read(path) for folder in folders for path in Path(folder).rglob("*.py"))


@documents
def test_options_and_configurations_of_commands_exist(document: Path) -> None:
    text = read(document)
    for line in [*quoted(text), *"\n".join(code_blocks(text)).splitlines()]:
        command = line.split("#")[0].split(" -- ")[0]
        source = sources_of(command)
        missing = [
            option for option in re.findall(r" (--[a-z][\w-]*)", command) if source and f'"{option}"' not in source
        ]
        assert set(missing) <= {"--cfg", "--help", "--nproc-per-node"}, command  # of Hydra, of argparse, of torchrun
    for group in ("stage", "budget", "experiment"):
        known = {path.stem for path in (PROJECT_ROOT / "conf" / group).glob("*.yaml")}
        assert set(re.findall(rf"(?<![\w./@]){group}=([a-z][\w-]*)", text)) <= known, group


@documents
def test_settings_exist(document: Path) -> None:
    from pipeline.stages import available_stages, load_stage

    stages = {name: set(load_stage(name).settings.__dataclass_fields__) for name in available_stages()}
    known = set().union(*stages.values())
    text = read(document)
    used = set(re.findall(r"(?<![\w/])stage\.([a-z]\w*)", "\n".join([*quoted(text), *code_blocks(text)])))
    assert not sorted(used - known)
    for stage, name in re.findall(r"\bstage@([a-z]\w*)\.([a-z]\w*)", text):
        assert name in stages[stage], f"stage@{stage}.{name}"


@documents
def test_python_blocks_import_what_exists(document: Path) -> None:
    for block in code_blocks(read(document), "python"):
        require_imports(block)


def test_documents_packages_and_citation_name_the_declared_addresses() -> None:
    folders = (PROJECT_ROOT, *(PROJECT_ROOT / "packages" / package for package in PACKAGES))
    declared, *others = (tomllib.loads(read(folder / "pyproject.toml"))["project"]["urls"] for folder in folders)
    assert declared.keys() == {"Repository", "Issues"}
    assert all(other == declared for other in others)
    assert all(f"<{address}>" in read(PROJECT_ROOT / "README.md") for address in declared.values())
    citation = PROJECT_ROOT / "CITATION.cff"
    assert yaml.safe_load(read(citation))["repository-code"] == declared["Repository"]
    for document in (*DOCUMENTS, citation):
        placeholders = re.findall(r"https?://example\.invalid[^\s>)\"'`]*", read(document))
        assert set(placeholders) <= set(declared.values()), relative(document)


def nav_pages(entry: object) -> Iterator[str]:
    """The pages of a part of the site's navigation."""
    if isinstance(entry, str):
        yield entry
    for part in entry if isinstance(entry, list) else entry.values() if isinstance(entry, dict) else ():
        yield from nav_pages(part)


def test_the_site_s_navigation_has_every_page_once() -> None:
    listed = list(nav_pages(yaml.safe_load(read(PROJECT_ROOT / "mkdocs.yml"))["nav"]))
    pages = {page.relative_to(DOCS).as_posix() for page in PAGES}
    assert len(listed) == len(set(listed))
    assert pages <= set(listed)
    outside = {"about.md", "tutorial.md", "models.md", "contributing.md", "changelog.md"}
    outside |= {f"{folder}/{package}.md" for folder in ("packages", "api") for package in PACKAGES}
    assert set(listed) - pages == outside
