"""The documentation as a site: complete in itself, with every link and anchor, and nothing fetched."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from functools import partial
from html import escape
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urljoin, urlsplit

import pytest
from markdown_it import MarkdownIt

from docs_site import heading, indented
from draw_block import SCALE
from tests.browser import WATCHDOG_MS, chromium

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
HOST = "http://site/"
BLOCKS = sorted(path for path in (DOCS / "reference/blocks").glob("*.md") if path.stem != "README")
TELEPHONE = {"width": 390, "height": 844}
PIN_TEXT = 11
"""Pixels of the smallest text in a block's drawing, at its scale 1."""
SERIOUS = ("serious", "critical")
STRUCTURE = (
    "h1",
    "h2",
    "h3",
    "h4",
    "h5",
    "ol",
    "ul",
    "li",
    "table",
    "tr",
    "pre",
    "blockquote",
    "img",
    "details",
)

pytestmark = [pytest.mark.needs("chromium"), pytest.mark.xdist_group("site"), pytest.mark.timeout(600)]


class Page(HTMLParser):
    """What a page of the site has: links, anchors, and the elements of its own text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self.elements: Counter[str] = Counter()
        self.text_links: list[str] = []
        self.inside = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        if "id" in values:
            self.anchors.add(values["id"])
        if tag in ("a", "link") and "href" in values:
            self.links.append(values["href"])
            if self.inside:
                self.text_links.append(values["href"])
        if tag == "link" and values.get("rel") not in ("canonical", "prev", "next"):
            self.fetched.append(values["href"])
        if "src" in values:
            self.links.append(values["src"])
            self.fetched.append(values["src"])
        if tag == "article":
            self.inside = True
        elif self.inside and tag in STRUCTURE:
            self.elements[tag] += 1

    def handle_endtag(self, tag: str) -> None:
        if tag == "article":
            self.inside = False


def address(page: Path) -> str:
    """Return a page's place in the site, as a browser asks for it."""
    path = page.relative_to(DOCS).with_suffix("")
    return "" if str(path) == "index" else f"{path.parent if path.name == 'README' else path}/"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make site` does."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    env = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, Page]:
    """Every page by its address."""
    found = {
        str(path.relative_to(site)).removesuffix("index.html"): Page(path.read_text(encoding="utf-8"))
        for path in site.rglob("*.html")
    }
    assert len(found) > 50
    return found


def test_every_link_and_anchor_of_the_site_leads_somewhere(site: Path, pages: dict[str, Page]) -> None:
    """What a reader can click is there, headings included."""
    broken = []
    for name, page in pages.items():
        for link in page.links:
            target = urlsplit(urljoin(HOST + ("" if name == "404.html" else name), link))
            if f"{target.scheme}://{target.netloc}/" != HOST:
                continue
            path = unquote(target.path).lstrip("/")
            if path not in pages and not (site / path).is_file():
                broken.append(f"{name}: {link}")
            elif target.fragment and path in pages and unquote(target.fragment) not in pages[path].anchors:
                broken.append(f"{name}: {link}, no such anchor")
    assert broken == []


def test_the_site_fetches_nothing_from_elsewhere(site: Path, pages: dict[str, Page]) -> None:
    """It works where there is no way out, and tells nobody that it is read."""
    fetched = {link for page in pages.values() for link in page.fetched}
    drawn = [path.read_text(encoding="utf-8") for path in site.rglob("*") if path.suffix in (".css", ".svg")]
    fetched |= set(re.findall(r"(?:url\(|@import |<image [^>]*href=\")[\"']?([^\"')]+)", "".join(drawn)))
    assert [link for link in sorted(fetched) if re.match("(https?:)?//", link)] == []


def test_every_page_stands_in_the_navigation(pages: dict[str, Page]) -> None:
    """A page that its section's README.md does not list is found by nobody who looks through the menu."""
    listed = {urljoin(HOST, link) for link in pages[""].links}
    missing = [page for page in DOCS.rglob("*.md") if HOST + address(page) not in listed]
    assert sorted(str(page.relative_to(ROOT)) for page in missing) == []


def test_the_menu_has_the_heading_of_each_page(site: Path) -> None:
    """What is above it, a comment for translators for example, does not take its place."""
    for path in sorted(DOCS.rglob("*.md")):
        if path != DOCS / "index.md":
            text = (site / address(path) / "index.html").read_text(encoding="utf-8")
            title = heading(str(path.relative_to(ROOT))).replace("`", "")
            assert f"<title>{escape(title, quote=False)} - rosplc</title>" in text, path.relative_to(ROOT)


def test_a_page_of_the_site_has_the_structure_that_it_has_elsewhere(pages: dict[str, Page]) -> None:
    """Lists, tables and blocks come out as any reader of CommonMark shows them."""
    markdown = MarkdownIt("commonmark", {"html": True}).enable("table")
    for path in sorted(DOCS.rglob("*.md")):
        elsewhere = Page(f"<article>{markdown.render(path.read_text(encoding='utf-8'))}</article>")
        assert pages[address(path)].elements == elsewhere.elements, path.relative_to(ROOT)


class Quiet(SimpleHTTPRequestHandler):
    """Serves the site without a word."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def served(site: Path) -> Iterator[str]:
    """The site's address."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium."""
    with chromium() as started:
        yield started


@pytest.mark.parametrize(
    ("scheme", "address"),
    [("light", "tutorial/into-service/"), ("light", "reference/blocks/RosPlc_Pose/"), ("dark", "")],
)
def test_pages_can_be_read_by_everybody(browser: Any, served: str, scheme: str, address: str) -> None:
    """Contrast, names and roles are in order."""
    from axe_playwright_python.sync_playwright import Axe

    page = browser.new_page(viewport=TELEPHONE, color_scheme=scheme)
    page.set_default_timeout(WATCHDOG_MS)
    page.goto(served + address)
    page.wait_for_selector(".md-search[aria-label]", state="attached")
    found = Axe().run(page).response["violations"]
    page.close()
    assert [(each["id"], each["nodes"][0]["html"]) for each in found if each["impact"] in SERIOUS] == []


def test_no_page_is_wider_than_a_telephone_or_fetches_from_elsewhere(browser: Any, served: str) -> None:
    """Drawings, tables and commands are pushed sideways in their own place."""
    page = browser.new_page(viewport=TELEPHONE)
    page.set_default_timeout(WATCHDOG_MS)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    for address in ("", "explanation/shared-memory-format/", "reference/cli/", "howto/use-ros-1/"):
        page.goto(served + address)
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), address
    page.close()
    assert [url for url in asked if not url.startswith((served, "data:", "blob:"))] == []


def test_pictures_fit_a_telephone(browser: Any, served: str) -> None:
    """They are seen whole, in a form or at a size that can be read there."""
    page = browser.new_page(viewport=TELEPHONE)
    page.set_default_timeout(WATCHDOG_MS)
    for place, number in (("", 1), ("explanation/shared-memory-format/", 5), ("howto/the-assembly-cell/", 1)):
        page.goto(served + place)
        shown = page.locator('.md-typeset img[src$=".svg"]')
        assert shown.count() == number
        for picture in shown.all():
            assert picture.evaluate("each => each.currentSrc").endswith("-narrow.svg")
            assert picture.evaluate("each => each.getBoundingClientRect().right") <= TELEPHONE["width"]
    for block in BLOCKS:
        page.goto(served + address(block))
        shown = page.locator('.md-typeset img[src*="/images/blocks/"]')
        right, width, natural = shown.evaluate(
            "each => [each.getBoundingClientRect().right, each.width, each.naturalWidth]"
        )
        assert right <= TELEPHONE["width"], block.stem
        assert PIN_TEXT * SCALE * width / natural > 9, f"{block.stem}: the text is too small"
    page.close()


def test_a_command_is_copied_without_its_prompt_and_output(browser: Any, served: str) -> None:
    """What a reader pastes into a terminal is the command."""
    context = browser.new_context(permissions=["clipboard-read", "clipboard-write"])
    context.set_default_timeout(WATCHDOG_MS)
    page = context.new_page()
    page.goto(served + "tutorial/first-steps/")
    shown = page.locator(".highlight:has(.gp)", has_text="rosplc demo --duration 3s").first
    shown.locator("button.md-code__button").click()
    page.wait_for_function("navigator.clipboard.readText().then(text => text !== '')")
    assert page.evaluate("navigator.clipboard.readText()") == "rosplc demo --duration 3s"
    context.close()


@pytest.mark.parametrize(
    ("word", "place"),
    [("seal", "explanation/shared-memory-format/"), ("RosPlc_Pose", "reference/blocks/RosPlc_Pose/")],
)
def test_the_search_finds_a_word(browser: Any, served: str, word: str, place: str) -> None:
    """The index is part of the site, and needs no server that computes."""
    context = browser.new_context()
    context.set_default_timeout(WATCHDOG_MS)
    page = context.new_page()
    page.goto(f"{served}?q={word}")
    page.wait_for_selector(".md-search-result__item", state="attached")
    found = [each.get_attribute("href") for each in page.locator(".md-search-result__link").all()]
    assert any(place in link for link in found), found
    context.close()


@pytest.mark.parametrize("person", ["first-steps", "codesys", "robot-topics", "into-service"])
def test_each_user_is_one_click_from_a_tutorial(pages: dict[str, Page], person: str) -> None:
    """The start page leads newcomers, technicians, robot programmers and integrators to their own."""
    assert f"tutorial/{person}/" in pages[""].text_links


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("1. a\n\n   b\n", "1. a\n\n    b\n"),
        ("1. a\n   * b\n     c\n2. d\n", "1. a\n    * b\n        c\n2. d\n"),
        (
            "* a\n\n  ```text\n  * x\n\n    y\n  ```\n\nz\n",
            "* a\n\n    ```text\n    * x\n\n      y\n    ```\n\nz\n",
        ),
        ("```text\n1. a\n   b\n```\n", "```text\n1. a\n   b\n```\n"),
        ("10. a\n    b\n\nc\n", "10. a\n    b\n\nc\n"),
        ("a:\n* b\n* c\n", "a:\n\n* b\n* c\n"),
    ],
)
def test_what_belongs_to_an_item_is_indented_by_four(text: str, shown: str) -> None:
    """Nested lists and blocks keep their place; a block's content is left alone."""
    assert indented(text) == shown
