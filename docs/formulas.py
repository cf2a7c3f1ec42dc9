"""Formulas, typeset by KaTeX, and links from the equations to the functions that compute them."""

import json
import pkgutil
import re
import unicodedata
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority

import drake_nonstop.mechanics
from drake_nonstop.diagrams.nonstop import BOXES

# The modules with the equations.
MECHANICS = sorted(module.name for module in pkgutil.iter_modules(drake_nonstop.mechanics.__path__))


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Has the names of functions and blocks beside the equations lead to their pages."""
    if page.file.src_uri == "theory.md":
        return linked_blocks(linked_functions(markdown))
    return linked_functions(markdown) if page.file.src_uri.startswith("boxes/") else markdown


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Has the formulas of a page typeset, where it has some."""
    if 'class="arithmatex"' in output:
        folder = "../" * page.url.count("/") + "katex/"
        style = f'<link rel="stylesheet" href="{folder}katex.min.css">'
        scripts = (f'<script src="{folder}{name}.js"></script>' for name in ("katex.min", "render"))
        output = output.replace("</head>", f"{style}</head>")
        output = output.replace("</body>", f"{''.join(scripts)}</body>")
    return output


@event_priority(-100)  # after the index has been written
def on_post_build(config: Any) -> None:
    """Has the search show formulas within a line as plain text, and no others."""
    for path in Path(config.site_dir, "search").glob("search_index.js*"):
        begin, brace, rest = path.read_text(encoding="utf-8").partition("{")
        index = json.loads(brace + rest)
        for part in index["docs"]:
            part["text"] = without_formulas(part["text"])
        path.write_text(begin + json.dumps(index, ensure_ascii=False), encoding="utf-8")


def without_formulas(text: str) -> str:
    r"""A text whose `\[ formulas \]` are left out, and whose `\( formulas \)` are plain text."""
    text = re.sub(r"\\\[.*?\\\]", "", text, flags=re.DOTALL)
    return re.sub(r"\\\((.*?)\\\)", lambda match: _plain(match[1]), text, flags=re.DOTALL)


def _plain(formula: str) -> str:
    """TeX with Greek letters as such, and without other commands, braces and scripts' signs."""

    def letter(match: re.Match[str]) -> str:
        name = match[1].upper().removeprefix("VAR").replace("LAMBDA", "LAMDA")
        name = f"GREEK {'SMALL' if match[1].islower() else 'CAPITAL'} LETTER {name}"
        try:
            return unicodedata.lookup(name)
        except KeyError:
            return " "

    return re.sub(r"[{}^_\\]", "", re.sub(r"\\([A-Za-z]+)", letter, formula)).strip()


def linked_functions(markdown: str) -> str:
    """Makes links of all `module.function` of `drake_nonstop.mechanics` in a text."""

    def linked(match: re.Match[str]) -> str:
        if match[1] not in MECHANICS:
            return match[0]
        return f"[{match[0]}][drake_nonstop.mechanics.{match[1]}.{match[2]}]"

    return re.sub(r"`(\w+)\.(\w+)`", linked, markdown)


def linked_blocks(markdown: str) -> str:
    """Makes links to the pages of the boxes of all names of blocks in a text."""
    places = {
        variant.__name__: f"boxes/{name}.md#{variant.__module__}.{variant.__name__}"
        for name, box in BOXES.items()
        for variant in box.variants
    }

    def linked(match: re.Match[str]) -> str:
        return f"[{match[0]}]({places[match[1]]})" if match[1] in places else match[0]

    return re.sub(r"`(\w+)`", linked, markdown)
