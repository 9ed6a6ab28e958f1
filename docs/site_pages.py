"""Adds to the documentation site what is no page below docs/: readmes, the notebook, and the packages' interfaces.

MkDocs calls the functions whose names begin with `on_` (``hooks`` of mkdocs.yml). Links are written as they lead
somewhere in the repository; on the site they lead to the page that stands for the file, and those to other files lose
their link.
"""

from __future__ import annotations

import base64
import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.structure.files import Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("cathsim", "enn", "guide3d", "splineformer")
NOTEBOOK = "docs/tutorial.ipynb"
# File of the repository to its page.
OUTSIDE = {
    "README.md": "about.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "models/README.md": "models.md",
    **{f"packages/{name}/README.md": f"packages/{name}.md" for name in PACKAGES},
    **{
        card.relative_to(ROOT).as_posix(): f"models/{card.stem}.md"
        for card in sorted(ROOT.glob("packages/*/src/*/weights/*.md"))
    },
    NOTEBOOK: "tutorial.md",
}
SOURCES = {page: source for source, page in OUTSIDE.items()}
PICTURE = re.compile(r"docs/tutorial_\d+\.png")  # of the notebook, made when the site is built
FENCED = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def slug(heading: str, separator: str = "-") -> str:
    """The anchor of a heading, as code hosts make it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", separator)


def site_path(source: str) -> str | None:
    """The path on the site of a file of the repository; None where the site does not have it."""
    if source in OUTSIDE:
        return OUTSIDE[source]
    inside = source.startswith("docs/") and not source.endswith(".py") and (ROOT / source).is_file()
    inside = inside or bool(PICTURE.fullmatch(source))
    return source.removeprefix("docs/") if inside else None


def with_links_of_the_site(markdown: str, page: str) -> str:
    """A page with the links of the repository turned into those of the site.

    Args:
        page: its path on the site.
    """
    source = SOURCES.get(page, f"docs/{page}")

    def changed(match: re.Match[str]) -> str:
        mark, text, link = match.groups()
        path, hash_sign, anchor = link.partition("#")
        if "://" in link or not path:
            return match[0]
        target = site_path(posixpath.normpath(posixpath.join(posixpath.dirname(source), path)))
        if target is None:
            return text
        return f"{mark}[{text}]({posixpath.relpath(target, posixpath.dirname(page) or '.')}{hash_sign}{anchor})"

    parts = FENCED.split(re.sub(r"^(```\w+) [\w-]+$", r"\1", markdown, flags=re.MULTILINE))
    return "".join(part if number % 2 else LINK.sub(changed, part) for number, part in enumerate(parts))


def notebook_page(notebook: dict[str, Any]) -> tuple[str, dict[str, bytes]]:
    """A notebook with its outputs as Markdown, and its pictures by name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                name = f"tutorial_{len(pictures)}.png"
                pictures[name] = base64.b64decode("".join(data["image/png"]))
                parts.append(f"![output]({name})")
            elif text := "".join(output.get("text", data.get("text/plain", ""))).rstrip():
                parts.append(f"```text\n{text}\n```")
    return "\n\n".join(parts) + "\n", pictures


def api_pages() -> Iterator[tuple[str, str]]:
    """The page of each package's interface and that of each of its folders: path on the site and Markdown."""
    for package in PACKAGES:
        root = ROOT / "packages" / package / "src" / package
        folders = sorted(path.parent for path in root.rglob("__init__.py"))
        pages = {folder: f"api/{'/'.join((package, *folder.relative_to(root).parts))}.md" for folder in folders}
        for folder, page in pages.items():
            name = ".".join((package, *folder.relative_to(root).parts))
            lines = [f"# {name}", ""]
            inner = [one for one in folders if one.parent == folder and one != folder]
            if inner:
                links = [f"[{one.name}]({posixpath.relpath(pages[one], posixpath.dirname(page))})" for one in inner]
                lines += ["Folders: " + ", ".join(links), ""]
            lines += [
                f"::: {name}",
                "    options: {members: false, show_root_heading: false, show_root_toc_entry: false}",
                "",
            ]
            for module in sorted(folder.glob("*.py")):
                if not module.stem.startswith("_"):
                    lines += [
                        f"## {module.stem}",
                        "",
                        f"::: {name}.{module.stem}",
                        "    options:",
                        "      show_root_heading: false",
                        "      show_root_toc_entry: false",
                        "",
                    ]
            yield page, "\n".join(lines)


def on_config(config: Any) -> Any:
    """Gives headings the anchors that the documents' links name."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = slug
    return config


def on_files(files: Files, config: Any) -> Files:
    """Adds the generated pages."""
    from mkdocs.structure.files import File

    for source, page in OUTSIDE.items():
        if source != NOTEBOOK:
            files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    text, pictures = notebook_page(json.loads((ROOT / NOTEBOOK).read_text(encoding="utf-8")))
    files.append(File.generated(config, OUTSIDE[NOTEBOOK], content=text))
    for name, picture in pictures.items():
        files.append(File.generated(config, name, content=picture))
    for page, content in api_pages():
        files.append(File.generated(config, page, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Turns the links of the repository into those of the site."""
    path = page.file.src_uri
    return markdown if path.startswith("api/") else with_links_of_the_site(markdown, path)
