"""Checks the built documentation: `python -m site_pages ../site` in this folder.

Links lead somewhere, pictures have texts, nothing is loaded from elsewhere, and no page is large
or, where Chromium is installed, wider than its window.
`--replays FOLDER` takes the pictures by which the first page shows its replays.
"""

import argparse
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

from drake_nonstop.validation import ScenarioError
from drake_nonstop.view.browser import open_browser

LARGEST_PAGE = 1_500_000  # bytes, with the pictures, styles and scripts that it loads

WIDTHS = 390, 1360  # pixels, of a phone's window and of a laptop's


class Page(HTMLParser):
    """What a page has: places, links, what it loads, and pictures without a text."""

    def __init__(self, text: str):
        super().__init__()
        self.places: set[str] = set()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.unlabelled: list[str] = []
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


def faults(site: Path) -> list[str]:
    """What is wrong with the pages in a folder, "page: fault"."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(site.rglob("*.html"))}
    pages = {path: Page(text) for path, text in texts.items() if path.parent.name != "replays"}
    found = []
    for path, page in pages.items():
        own = [*broken_links(path, pages), *(f"no alt text: {name}" for name in page.unlabelled)]
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


def wide_pages(site: Path) -> list[str]:
    """The pages that scroll to the side at one of the widths, "page: fault"."""
    found = []
    with open_browser(*WIDTHS) as page:
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 800})
            for path in sorted({*site.rglob("*.html")} - {*site.glob("replays/*")}):
                page.goto(path.as_uri())
                if page.evaluate("document.documentElement.scrollWidth") > width:
                    found.append(f"{path.relative_to(site)}: wider than {width} pixels")
    return found


def picture_replays(site: Path, folder: Path, share: float = 0.55) -> None:
    """A picture of each replay, at a share of its time."""
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
    try:
        found += wide_pages(options.site.resolve())
    except ScenarioError as error:
        print(f"widths are not measured: {error}")
    print("\n".join(found) or "nothing is wrong with the pages")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
