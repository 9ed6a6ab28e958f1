"""The documents match the repository: names, paths, links, commands, tables of modules, length and wording."""

from __future__ import annotations

import ast
import functools
import importlib
import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

PROJECT_ROOT = Path(__file__).resolve().parents[2]
DOCS = PROJECT_ROOT / "docs"
ARCHITECTURE = DOCS / "architecture.md"
TABLES = DOCS / "pipeline" / "tables.md"
PACKAGES = ("cathsim", "enn", "guide3d", "splineformer")
READMES = [PROJECT_ROOT / "models" / "README.md"]
READMES += [PROJECT_ROOT / "packages" / package / "README.md" for package in PACKAGES]
PAGES = sorted(DOCS.rglob("*.md"))
STAGES = {path.stem for path in (PROJECT_ROOT / "conf" / "stage").glob("*.yaml")}
TOP = [PROJECT_ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
CONTENTS = DOCS / "index.md"
DOCUMENTS = [*TOP, *READMES, *PAGES]
WORD_LIMIT = 1_200
FOLDERS = ("pipeline/", "packages/", "benchmarks/", "tests/", "conf/", "docs/", "examples/")
DOTTED = re.compile(rf"(?:{'|'.join((*PACKAGES, 'pipeline'))})(?:\.\w+)+")
# Groups of entry points, which look like modules and are none.
ENTRY_POINTS = {"cathsim.recorders"}
# Names that the documents give as examples, and one of torch.
OTHER_NAMES = {"branch_1", "error_mm", "angle_deg", "autograd", "saved_tensors_hooks"}
COMMIT = re.compile(r"[0-9a-f]{7}")
# Words that have a plain one in the field's language.
UNWANTED = re.compile(
    r"\b(eyes?|lessons?|pupils?|judgements?|intake|drift(?:s|ed)?|ink|clumsy|likewise|at a desk|spares? the wall"
    r"|what is odd|told|foretold|anew|memory's)\b",
    re.IGNORECASE,
)


def relative(document: Path) -> str:
    return document.relative_to(PROJECT_ROOT).as_posix()


def without_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)


def quoted(text: str) -> list[str]:
    """What stands between single backticks outside blocks of code."""
    return re.findall(r"`([^`\n]+)`", without_blocks(text))


def code_blocks(text: str, language: str = r"\w*") -> list[str]:
    return re.findall(rf"^```{language}(?: [\w-]+)?\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one, or a field of a class in one."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError as error:
            if error.name is None or not name.startswith(error.name):  # an optional dependency is missing
                return True
            continue
        for part in parts[length:]:
            if not hasattr(found, part):
                return part in getattr(found, "__dataclass_fields__", {})
            found = getattr(found, part)
        return True
    return False


def run_settings() -> set[str]:
    """Names such as ``guide3d.root``, which are settings of a run and look like modules."""
    from pipeline.config import RunConfig

    source = RunConfig.__dataclass_fields__["guide3d"].default_factory
    return {f"guide3d.{name}" for name in source.__dataclass_fields__}


def read(document: Path) -> str:
    return document.read_text(encoding="utf-8")


documents = pytest.mark.parametrize("document", DOCUMENTS, ids=relative)


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name != "results"], ids=relative)
def test_page_is_short(page: Path) -> None:
    assert len(read(page).split()) <= WORD_LIMIT


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


@documents
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


@functools.cache
def source_words() -> set[str]:
    """Every word of the sources, tests, settings and pages of the console."""
    words = set(re.findall(r"\w+", read(PROJECT_ROOT / "Makefile")))
    for folder in ("packages", "pipeline", "conf", "benchmarks", "tests"):
        for path in (PROJECT_ROOT / folder).rglob("*"):
            if path.suffix in {".py", ".yaml", ".c", ".h", ".js", ".toml"} and path != Path(__file__):
                words.update(re.findall(r"\w+", read(path)))
    return words


@documents
def test_identifiers_occur_in_the_sources(document: Path) -> None:
    names = [re.match(r"[A-Za-z_][\w.]*(?=[(=]|$)", text) for text in quoted(read(document))]
    parts = {part for name in names if name for part in name[0].split(".") if part}
    assert not sorted(part for part in parts - source_words() - OTHER_NAMES if not COMMIT.fullmatch(part))


def require_imports(source: str) -> None:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module and DOTTED.match(f"{node.module}.x"):
            assert all(resolves(f"{node.module}.{alias.name}") for alias in node.names), ast.unparse(node)
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if DOTTED.match(f"{alias.name}.x")]
            assert all(resolves(name) for name in names), ast.unparse(node)


@documents
def test_python_blocks_import_what_exists(document: Path) -> None:
    for block in code_blocks(read(document), "python"):
        require_imports(block)


@pytest.mark.parametrize("script", sorted((DOCS / "pictures").glob("*.py")), ids=relative)
def test_scripts_of_the_pictures_import_what_exists(script: Path) -> None:
    require_imports(read(script))


@documents
def test_words_are_plain(document: Path) -> None:
    assert not sorted({found[0] for found in UNWANTED.finditer(read(document))})


def package_folders(package: str) -> tuple[Path, set[str]]:
    """The source folder of a package, and its folders with an ``__init__`` as paths below it."""
    root = PROJECT_ROOT / "pipeline" if package == "pipeline" else PROJECT_ROOT / "packages" / package / "src" / package
    return root, {one.parent.relative_to(root).as_posix() for one in root.rglob("__init__.py")} - {"."}


def listed_folders() -> set[str]:
    """The folders that the tree of the architecture page lists, as paths from the repository's root."""
    tree = next(block for block in code_blocks(read(ARCHITECTURE)) if "packages/cathsim/src/cathsim/" in block)
    listed: set[str] = set()
    parents: list[str] = []
    for line in tree.splitlines():
        if found := re.match(r"( *)([\w./-]+)/ ", line):
            depth = len(found[1]) // 2
            parents = [*parents[:depth], found[2]]
            listed.add("/".join(parents))
    return listed


def test_tree_of_the_architecture_is_that_of_the_repository() -> None:
    listed = listed_folders()
    assert not sorted(folder for folder in listed if not (PROJECT_ROOT / folder).is_dir())
    for package in (*PACKAGES, "pipeline"):
        root, folders = package_folders(package)
        base = relative(root)
        assert {base, *(f"{base}/{folder}" for folder in folders)} <= listed
    for parent in ("docs", "tests", "benchmarks", "conf"):
        kept = {relative(path) for path in (PROJECT_ROOT / parent).iterdir() if path.is_dir() and any(path.glob("*.*"))}
        assert kept - {f"{parent}/__pycache__"} <= listed


def table_column(text: str, header: str) -> list[str]:
    """The first cells of the tables whose first header cell is this."""
    cells: list[str] = []
    inside = False
    for line in text.splitlines():
        first = line.split("|")[1].strip() if line.startswith("|") else None
        inside = first is not None and (inside or first == header)
        if inside and first is not None and first != header and not set(first) <= set("-: "):
            cells.append(first)
    return cells


def test_tables_of_stages_are_complete() -> None:
    for document in (ARCHITECTURE, DOCS / "pipeline" / "stages.md"):
        listed = [cell.strip("`") for cell in table_column(read(document), "stage")]
        assert set(listed) == STAGES, relative(document)
        assert len(listed) == len(STAGES)


def test_every_table_of_the_report_is_listed_with_its_stage_and_module() -> None:
    tables = yaml.safe_load(read(PROJECT_ROOT / "pipeline" / "report" / "thesis.yaml"))["tables"]
    rows = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in read(TABLES).splitlines()]
    listed = {row[0]: row[1:] for row in rows if row and row[0] in tables}
    assert listed.keys() == tables.keys()
    for name, (title, _, stage, module) in listed.items():
        assert (title, stage) == (tables[name]["title"], tables[name].get("stage", "")), name
        source = importlib.util.find_spec(module)
        assert source, module
        assert f'"{name}"' in read(Path(str(source.origin))), f"{module} makes no table {name}"


def test_every_page_of_the_documents_is_listed_in_the_contents() -> None:
    text = read(CONTENTS)
    pages = [page.relative_to(DOCS).as_posix() for page in PAGES if page != CONTENTS]
    assert not [page for page in pages if f"]({page})" not in text]
    assert "](docs/index.md)" in read(PROJECT_ROOT / "README.md")


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


def test_every_film_is_shown_and_small() -> None:
    films = sorted((DOCS / "pictures").rglob("*.gif"))
    shown = read(DOCS / "gallery.md")
    assert films
    for film in films:
        assert f"]({film.relative_to(DOCS).as_posix()})" in shown
        assert film.stat().st_size < 1_000_000, relative(film)


def news() -> list[str]:
    """The lines of the readme that say what is new."""
    section = re.search(r"^## What is new\n(.*?)^## ", read(PROJECT_ROOT / "README.md"), re.DOTALL | re.MULTILINE)
    assert section
    return re.findall(r"^- .*$", section[1], re.MULTILINE)


@pytest.mark.parametrize("line", news(), ids=lambda line: line[4:30])
def test_figures_of_the_readme_stand_in_the_results(line: str) -> None:
    (link,) = re.findall(r"\]\((docs/results/[\w.]+)\)", line)
    figures = re.findall(r"\d+(?:\.\d+)?", re.sub(r"\]\([^)]*\)|\*\*.*?\*\*|95 %|Simmons 2", "", line))
    found = set(re.findall(r"\d+(?:\.\d+)?", read(PROJECT_ROOT / link)))
    assert figures
    assert not sorted(set(figures) - found)
    assert re.search(r"\(\d[\d.]* to \d[\d.]*\)", line), "an interval"


def test_readme_is_short_and_shows_a_small_film() -> None:
    text = read(PROJECT_ROOT / "README.md")
    assert len(text.split()) <= WORD_LIMIT
    before_news = text.split("## What is new")[0]
    (film,) = re.findall(r"!\[[^\]]+\]\(([^)]+\.gif)\)", before_news)
    assert (PROJECT_ROOT / film).stat().st_size < 1_000_000
    assert len(news()) == 5


def test_the_thesis_is_cited() -> None:
    citation = yaml.safe_load(read(PROJECT_ROOT / "CITATION.cff"))
    (thesis,) = citation["references"]
    (author,) = thesis["authors"]
    cited = (author["given-names"], author["family-names"], thesis["title"], thesis["institution"]["name"])
    assert all(part in read(PROJECT_ROOT / "README.md").replace("\n", " ") for part in (*cited, str(thesis["year"])))
    version = re.search(r'^version = "(.+)"$', read(PROJECT_ROOT / "pyproject.toml"), re.MULTILINE)
    assert version
    assert citation["version"] == version[1]


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name == "results"], ids=relative)
def test_measured_figures_have_a_command(page: Path) -> None:
    said = re.compile(r"^```|ot recorded|Command:", re.MULTILINE)
    introduction, *sections = re.split(r"^## ", read(page), flags=re.MULTILINE)
    if not said.search(introduction):
        assert sections
        assert not [section.splitlines()[0] for section in sections if not said.search(section)]


def test_readme_lists_every_folder_of_the_repository() -> None:
    tree = next(block for block in code_blocks(read(PROJECT_ROOT / "README.md")) if "pipeline/ " in block)
    listed = set(re.findall(r"^([\w./]+)/ ", tree, re.MULTILINE))
    assert listed == {"packages/" + package for package in PACKAGES} | {
        "pipeline",
        "conf",
        "docs",
        "tests",
        "benchmarks",
        "examples",
        "models",
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_table_of_modules_covers_the_package(package: str) -> None:
    text = read(PROJECT_ROOT / "packages" / package / "README.md")
    named = {name for cell in table_column(text, "module") for name in re.findall(r"`([\w.]+)`", cell)}
    assert not sorted(name for name in named if not resolves(name))
    _, folders = package_folders(package)
    top = {f"{package}.{folder}" for folder in folders if "/" not in folder}
    assert not sorted(top - named)


def test_a_wrong_name_path_and_link_are_found(tmp_path: Path) -> None:
    assert not resolves("cathsim.observations.nothing")
    assert not resolves("enn.policy.Policy.nothing")
    assert resolves("enn.policy.Policy.load")
    assert list(paths_in("see `pipeline/nothing.py` and\n```\npython benchmarks/none.py\n```\n")) == [
        "pipeline/nothing.py",
        "benchmarks/none.py",
    ]
    assert anchors("# Seeds and sweeps\n## Task, and more\n") == {"seeds-and-sweeps", "task-and-more"}
    assert yaml.safe_load(read(PROJECT_ROOT / "conf" / "config.yaml"))["defaults"]
    assert UNWANTED.search("the navigator's eye")
