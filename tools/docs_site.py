"""Hooks of MkDocs for this site: what is beside docs/ is part of it, and the indexes are the navigation.

* A link that leads out of ``docs/`` is followed: the pages of ``spec/`` and the like become pages of the
  site, any other file is shown as a page of its own, and a folder as its README or a list of its files.
  The site is complete in itself, and says what this version of the sources says.
* A drawing that has a narrow one beside it, ``NAME-narrow.svg``, is that on a telephone.
* A block that the page's reader writes to a file has the file's name above it.
* The navigation is what each folder's ``README.md`` lists. A page is listed once, by hand, where its readers
  look for it, and there is no second list to forget.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.slugs import slugify

from links import relative_links, rewrite

ROOT = Path(__file__).resolve().parent.parent
DOCS = "docs/"
SECTIONS = ("tutorial", "howto", "reference", "explanation")
# Texts at the repository's top would take the start page's place.
PROJECT = {name: f"project/{name.lower()}" for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")}
LANGUAGES = {".py": "python", ".st": "iecst", ".yaml": "yaml", ".c": "c", ".h": "c", ".json": "json"}
ITEM = re.compile(r"(?:[*+-]|\d+\.) +(?=\S)")
FILE = re.compile(r"^( *<!-- file: (\S+) -->\n(?: *<!--.*-->\n)* *```\w+)$", re.MULTILINE)
_sources: dict[str, str] = {}  # page of the site → path in the repository


def place(path: str) -> str:
    """Return the page of the site for a path in the repository."""
    if path.startswith(DOCS):
        return path.removeprefix(DOCS)
    if path in PROJECT:
        return PROJECT[path]
    if (ROOT / path).is_dir():
        return (
            place(f"{path}/README.md") if (ROOT / path / "README.md").exists() else f"source/{path}/index.md"
        )
    return path if path.endswith(".md") else f"source/{path}.md"


def content(path: str) -> str:
    """Return the page that shows a file, or the files of a folder, of the repository."""
    target = ROOT / path
    if target.is_dir():
        files = sorted(each for each in target.iterdir() if each.is_file())
        return f"# {path}\n\n" + "".join(f"* [`{each.name}`]({each.name})\n" for each in files)
    text = target.read_text(encoding="utf-8")
    if path.endswith(".md"):
        return text
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"# {path}\n\n{fence}{LANGUAGES.get(target.suffix, 'text')}\n{text.rstrip()}\n{fence}\n"


def resolve(source: str, link: str) -> str:
    """Return the path in the repository that a link on a page leads to."""
    folder = source if (ROOT / source).is_dir() else posixpath.dirname(source)
    return posixpath.normpath(posixpath.join(folder, link))


def navigation(section: str) -> list[Any]:
    """Return what a folder's README.md lists: its pages in order, under its headings.

    Of an item or a table's row the links to pages of the same folder count, and the first one if it leads
    to a page beside docs/. A folder's README.md brings the pages that it lists itself.
    """
    index = f"{section}/README.md"
    entries: list[Any] = [index]
    group, listed = entries, {index}
    for line in (ROOT / DOCS / index).read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            group = []
            entries.append({line.removeprefix("## ").strip(): group})
        elif line.startswith(("* ", "|", "  ")) or re.match(r"\d+\. ", line):
            for number, link in enumerate(relative_links(line)):
                path = resolve(DOCS + index, link.partition("#")[0])
                page = place(path)
                beside = number == 0 and not path.startswith(DOCS)
                if (page.startswith(f"{section}/") or beside) and page.endswith(".md") and page not in listed:
                    listed.add(page)
                    folder = posixpath.dirname(page)
                    below = page == f"{folder}/README.md" and not beside
                    group.append({heading(path): navigation(folder)} if below else page)
    return [entry for entry in entries if not isinstance(entry, dict) or any(entry.values())]


def indented(text: str) -> str:
    """Return a page with lists as Python-Markdown wants them; the pages are CommonMark.

    What belongs to an item is indented by four, not to where the item's text begins, and a list begins after
    an empty line.
    """
    lines: list[str] = []
    columns: list[int] = []  # where the text of each open list's item begins
    shift, fence, blank = 0, "", True
    for line in text.splitlines():
        body = line.lstrip()
        indent = len(line) - len(body)
        if not fence and body:
            item = ITEM.match(body)
            first = not columns
            while columns and indent < columns[-1] and (blank or item or body.startswith("```")):
                columns.pop()
            shift = 4 * len(columns) - columns[-1] if columns and indent >= columns[-1] else 0
            if item:
                if first and not blank:
                    lines.append("")  # a list may follow a paragraph at once
                columns.append(indent + len(item[0]))
        lines.append(" " * shift + line if body else "")
        if body.startswith("```"):
            ticks = body[: len(body) - len(body.lstrip("`"))]
            fence = "" if fence == ticks else fence or ticks
        blank = not body
    return "\n".join(lines) + "\n"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Build the navigation, and form anchors as GitHub does, where the pages are read, too."""
    config.mdx_configs["toc"]["slugify"] = slugify(case="lower")
    titles = {section: heading(f"{DOCS}{section}/README.md") for section in SECTIONS}
    config.nav = [
        {"Start": "index.md"},
        *({titles[section]: navigation(section)} for section in SECTIONS),
        {"Project": [place(path) for path in (*PROJECT, "examples", "spec/vectors")]},
    ]
    return config


def heading(path: str) -> str:
    """Return a page's title."""
    match = re.search(r"^# (.+)$", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE)
    return match[1] if match else path


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what pages link to beyond docs/, and what that links to in turn."""
    _sources.clear()
    waiting = [DOCS + file.src_uri for file in files.documentation_pages()]
    waiting += [*PROJECT, "examples", "spec/vectors"]
    while waiting:
        path = waiting.pop()
        page = place(path)
        if page in _sources:
            continue
        if (ROOT / path / "README.md").exists():
            path = f"{path}/README.md"
        _sources[page] = path
        text = content(path)
        if not path.startswith(DOCS):
            files.append(File.generated(config, page, content=text))
        for link in relative_links(text):
            target = resolve(path, link.partition("#")[0]) if not link.startswith("#") else path
            if (target.endswith(".md") or not target.startswith(DOCS)) and (ROOT / target).exists():
                waiting.append(target)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead each link to its target's page in the site."""
    if page.file.src_uri == "index.md":
        page.meta["hide"] = ["navigation", "toc"]  # it is short, and leads on by itself
    if page.file.src_uri.startswith("source/"):
        page.meta["search"] = {"exclude": True}
    source = _sources[page.file.src_uri]
    folder = posixpath.dirname(page.file.src_uri)

    def led(link: str) -> str:
        name, hash_, anchor = link.partition("#")
        if not name:
            return link
        return posixpath.relpath(place(resolve(source, name)), folder or ".") + hash_ + anchor

    # A comment above a page's title would hide it from the menu.
    markdown = re.sub(r"\A<!--.*?-->\s*", "", markdown)
    markdown = FILE.sub(r'\1 title="\2"', markdown)
    # Markdown inside of HTML is Markdown, as on GitHub.
    return indented(rewrite(markdown, led)).replace("<details>", '<details markdown="1">')


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Show a drawing's narrow form on a narrow screen."""

    def responsive(found: re.Match[str]) -> str:
        narrow = f"{found[1]}-narrow.svg"
        if files.get_file_from_path(f"images/{posixpath.basename(narrow)}") is None:
            return found[0]
        return f'<picture><source media="(max-width: 44.9375em)" srcset="{narrow}">{found[0]}</picture>'

    return re.sub(r'<img [^>]*?src="([^"]*)\.svg"[^>]*>', responsive, html)
