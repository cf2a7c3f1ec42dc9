"""Formulas, typeset by KaTeX, and links from the equations to the functions that compute them."""

import pkgutil
import re
from typing import Any

import drake_nonstop.mechanics

# The modules with the equations.
MECHANICS = sorted(module.name for module in pkgutil.iter_modules(drake_nonstop.mechanics.__path__))


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Has the names of functions in the text of the equations lead to the reference."""
    return linked_functions(markdown) if page.file.src_uri == "theory.md" else markdown


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Has the formulas of a page typeset, where it has some."""
    if 'class="arithmatex"' in output:
        folder = "../" * page.url.count("/") + "katex/"
        style = f'<link rel="stylesheet" href="{folder}katex.min.css">'
        scripts = (f'<script src="{folder}{name}.js"></script>' for name in ("katex.min", "render"))
        output = output.replace("</head>", f"{style}</head>")
        output = output.replace("</body>", f"{''.join(scripts)}</body>")
    return output


def linked_functions(markdown: str) -> str:
    """A text whose `module.function` of `drake_nonstop.mechanics` are links, by mkdocstrings."""

    def linked(match: re.Match[str]) -> str:
        if match[1] not in MECHANICS:
            return match[0]
        return f"[{match[0]}][drake_nonstop.mechanics.{match[1]}.{match[2]}]"

    return re.sub(r"`(\w+)\.(\w+)`", linked, markdown)
