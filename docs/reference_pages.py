"""The reference: a page per module of equations, and per other package."""

import importlib
import inspect
import pkgutil
from pathlib import Path
from typing import Any

import drake_nonstop
import drake_nonstop.mechanics
from drake_nonstop.diagrams.nonstop import BOXES

# The modules with the equations.
MECHANICS = sorted(module.name for module in pkgutil.iter_modules(drake_nonstop.mechanics.__path__))


def on_config(config: Any) -> None:
    """Puts the pages into the navigation, below what lists them all."""
    groups: dict[str, list[str]] = {"Boxes": [f"boxes/{name}.md" for name in BOXES]}
    groups |= {"Equations": [], "Packages": []}
    for name in reference_pages():
        kind = name.split("/")[1].partition("_")[0]
        groups[{"equations": "Equations", "package": "Packages"}[kind]].append(name)
    own = [{"All names": "reference.md"}, *({k: names} for k, names in groups.items())]
    config["nav"] = [*config["nav"][:-1], {"Reference": own}]


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages."""
    from mkdocs.structure.files import File

    for name, text in {"reference.md": index_page(), **reference_pages()}.items():
        files.append(File.generated(config, name, content=text))
    return files


def names_by_page() -> dict[str, list[str]]:
    """Blocks by the page of their box, and all other public names by that of their package."""
    pages = {
        f"boxes/{name}.md": [variant.__name__ for variant in box.variants]
        for name, box in BOXES.items()
    }
    blocks = {name for names in pages.values() for name in names}
    packages: dict[str, list[str]] = {}
    for name in drake_nonstop.__all__:
        module = getattr(getattr(drake_nonstop, name), "__module__", "")
        if name not in blocks and module:
            packages.setdefault(f"reference/package_{module.split('.')[1]}.md", []).append(name)
    return {**pages, **dict(sorted(packages.items()))}


def _named(name: str) -> Any:
    """The public object or block of that name."""
    blocks = {v.__name__: v for box in BOXES.values() for v in box.variants}
    return blocks.get(name) or getattr(drake_nonstop, name)


def reference_pages() -> dict[str, str]:
    """The pages by the names of their files; mkdocstrings fills in what follows `:::`."""
    pages = {}
    for page, names in names_by_page().items():
        if page.startswith("boxes/"):  # made with the figure
            continue
        name = Path(page).stem.partition("_")[2]
        package = importlib.import_module(f"drake_nonstop.{name}")
        head = (inspect.getdoc(package) or "").partition("\n\n")[0]
        parts = [_entry(each) for each in names]
        pages[page] = "\n\n".join([f"# `{name}`", head, *parts, ""])
    for name in MECHANICS:
        entry = f"::: drake_nonstop.mechanics.{name}\n    options: {{show_root_heading: false}}"
        pages[f"reference/equations_{name}.md"] = f"# `mechanics.{name}`\n\n{entry}\n"
    return pages


def index_page() -> str:
    """Every public name, with a link to its description."""
    lines = [
        "# Reference",
        "",
        "Every name that `import drake_nonstop` offers, and all blocks, which",
        "`drake_nonstop.blocks.BOX` has. Other names are described with the package's folder. The",
        "functions behind the [equations](theory.md) have a page for each module of",
        "`drake_nonstop.mechanics`.",
    ]
    kind = ""
    for page, names in names_by_page().items():
        before, kind = kind, page.partition("/")[0]
        if kind != before:
            lines += ["", {"boxes": "## Boxes", "reference": "## Packages"}[kind]]
        title = Path(page).stem.removeprefix("package_")
        links = ", ".join(f"[`{name}`]({page}#{_place(name)})" for name in names)
        lines += ["", f"**[`{title}`]({page})**: {links}."]
    links = ", ".join(f"[`{name}`](reference/equations_{name}.md)" for name in MECHANICS)
    return "\n".join([*lines, "", "## Equations", "", f"{links}.", ""])


def _place(name: str) -> str:
    """Where on its page a name is."""
    value = _named(name)
    return f"{value.__module__}.{name}" if _is_documented(name) else name


def _is_documented(name: str) -> bool:
    """Whether mkdocstrings describes it: a class or a function by its own name."""
    value = _named(name)
    own = getattr(value, "__name__", name) == name
    return own and (inspect.isclass(value) or inspect.isfunction(value))


def _entry(name: str) -> str:
    value = _named(name)
    if _is_documented(name):
        return f"::: {value.__module__}.{name}"
    other = getattr(value, "__name__", name)
    text = f"Another name of `{other}`." if other != name else inspect.getdoc(value) or ""
    text = text.replace("<", "&lt;")
    return f"## {name} {{: #{name} }}\n\n{text}"
