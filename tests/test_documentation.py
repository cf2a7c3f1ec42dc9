"""The pages that are made from the code have all of it; `make docs` checks their links."""

import re
from pathlib import Path

import pytest

import drake_nonstop
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS

DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def hooks():
    names = {"__name__": "hooks"}
    exec(compile((DOCS / "hooks.py").read_text(encoding="utf-8"), "hooks.py", "exec"), names)
    return names


def test_every_public_name_is_in_the_reference(hooks):
    page = hooks["reference_page"]()
    found = set(re.findall(r"(?m)^(?:::: .*\.|### )(\w+)$", page))
    assert found >= {name for name in drake_nonstop.__all__ if not name.startswith("__")}


def test_every_signal_has_its_layout(hooks):
    page = hooks["signals_page"]()
    for name, layout in SIGNALS.items():
        section = page.partition(f"## `{name}` ")[2].partition("\n## ")[0]
        assert section
        for part in layout.parts if layout is not None else ():
            assert f"| {part.name} | {part.size} | {part.unit} | {part.frame} |" in section


def test_every_block_has_its_parameters(hooks):
    page = hooks["blocks_page"]()
    for name, box in BOXES.items():
        section = page.partition(f"## `{name}` ")[2].partition("\n## ")[0]
        for block, config in zip(box.variants, box.configs, strict=True):
            own = section.partition(f"### {block.__name__} ")[2].partition("\n### ")[0]
            for field in config.__dataclass_fields__:
                assert f"| `{field}` |" in own, f"{block.__name__}.{field}"


def test_every_box_of_the_figure_is_a_link(hooks):
    page = hooks["figure_page"]()
    for name in BOXES:
        assert f'<a href="blocks.html#{name}"><g data-block="{name}">' in page


def test_every_page_is_in_the_navigation():
    text = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r": ([\w/]+\.(?:md|ipynb))$", text, re.MULTILINE))
    made = {"figure.md", "blocks.md", "signals.md", "reference.md"}
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    notebooks = {path.relative_to(DOCS).as_posix() for path in DOCS.glob("notebooks/*.ipynb")}
    assert named == pages | notebooks | made
    assert "\nstrict: true\n" in text
