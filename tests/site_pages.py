"""Checks the built documentation: `python -m site_pages ../site` in this folder.

Links lead somewhere, pictures have texts, headings divide long pages, nothing is loaded from
elsewhere, and no page is large. `--replays FOLDER` takes the pictures by which the first page shows
its replays.
"""

import argparse
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

LARGEST_PAGE = 1_500_000  # bytes, with the pictures, styles and scripts that it loads
MOST_WORDS = 600  # between two headings, but for docstrings
_UNREAD = {"pre", "svg", "style", "script", "table"}  # no running text
_EMPTY = {"br", "hr", "img", "input", "link", "meta", "source", "wbr"}  # tags without an end


class Page(HTMLParser):
    """What a page has: places, links, what it loads, headings and words."""

    def __init__(self, text: str):
        super().__init__()
        self.places: set[str] = set()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.unlabelled: list[str] = []
        self.headings: list[int] = []
        self.words = [0]  # of the article, before and after each heading
        self._open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value for name, value in attrs if value}
        self.places |= {given[name] for name in ("id", "name") if name in given and tag != "meta"}
        self.links |= {given[name] for name in ("href", "src") if name in given}
        if tag != "iframe" and not given.get("src", "data:").startswith("data:"):  # another page
            self.loaded.add(given["src"])
        if tag == "link" and given.get("rel") == "stylesheet":
            self.loaded.add(given["href"])
        if tag == "img" and not given.get("alt"):
            self.unlabelled.append(given.get("src", "img")[:80])
        if re.fullmatch(r"h[1-6]", tag) and "article" in self._open:
            self.headings.append(int(tag[1]))
            self.words.append(0)
        if tag not in _EMPTY:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if "article" in self._open and not _UNREAD & {*self._open}:
            self.words[-1] += len(data.split())


def faults(site: Path) -> list[str]:
    """What is wrong with the pages in a folder, "page: fault"."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(site.rglob("*.html"))}
    pages = {path: Page(text) for path, text in texts.items() if path.parent.name != "replays"}
    found = []
    for path, page in pages.items():
        own = [*broken_links(path, pages), *(f"no alt text: {name}" for name in page.unlabelled)]
        if page.headings.count(1) != 1:
            own.append(f"{page.headings.count(1)} headings of the first level")
        steps = zip(page.headings, page.headings[1:], strict=False)
        own += [f"a heading h{b} after h{a}" for a, b in steps if b > a + 1]
        if max(page.words) > MOST_WORDS and path.parent.name not in ("boxes", "reference"):
            own.append(f"{max(page.words)} words without a heading")
        outside = [link for link in page.loaded if re.match(r"https?:|//", link)]
        own += [f"loaded from elsewhere: {link}" for link in outside]
        files = {path.parent / unquote(link.partition("?")[0]) for link in page.loaded}
        size = sum(file.stat().st_size for file in {path, *files} if file.is_file())
        if size > LARGEST_PAGE:
            own.append(f"{size / 1e6:.2f} MB")
        found += [f"{path.relative_to(site)}: {fault}" for fault in own if path.name != "404.html"]
    return found


def broken_links(path: Path, pages: dict[Path, Page]) -> list[str]:
    """The links of a page within the site that lead nowhere."""
    broken = []
    for link in sorted(pages[path].links):
        target, _, place = link.partition("#")
        if re.match(r"[a-z]+:|//?", link):
            continue  # elsewhere: not checked
        file = (path.parent / unquote(target.partition("?")[0])).resolve() if target else path
        is_there = file.is_file() or (file / "index.html").is_file()
        if place and file in pages:
            is_there = unquote(place) in pages[file].places or place == "__skip"
        broken += [] if is_there else [f"broken link: {link}"]
    return broken


def picture_replays(site: Path, folder: Path, share: float = 0.55) -> None:
    """A picture of each replay, at a share of its time."""
    from drake_nonstop.view.browser import open_browser

    with open_browser(600, 512) as page:
        for path in sorted((site / "replays").glob("*.html")):
            page.goto(f"{path.resolve().as_uri()}#embedded")
            page.wait_for_function("viewer.animator.actions.length > 0")
            seek = "viewer.animator.pause(); viewer.animator.seek(share * viewer.animator.duration)"
            page.evaluate(f"(share) => {{ {seek}; viewer.render(); }}", share)
            file = folder / f"replay_{path.stem}.jpg"
            scene = {"x": 0, "y": 0, "width": 600, "height": 450}
            page.screenshot(path=file, type="jpeg", quality=80, clip=scene)


def main() -> int:
    """The command; its exit code is 1 where something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("site", type=Path)
    parser.add_argument("--replays", type=Path)
    options = parser.parse_args()
    if options.replays:
        picture_replays(options.site, options.replays)
    found = faults(options.site.resolve())
    print("\n".join(found) or "nothing is wrong with the pages")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
