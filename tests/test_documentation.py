"""The pages that are made from the code have all of it; `make docs` checks their links."""

import dataclasses
import importlib
import re
from pathlib import Path

import pytest
import yaml

import drake_nonstop
from drake_nonstop import AircraftParameters, RunLimits, Scenario, SceneConfig, SystemParameters
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS

DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def hooks():
    names = {"__name__": "hooks"}
    exec(compile((DOCS / "hooks.py").read_text(encoding="utf-8"), "hooks.py", "exec"), names)
    return names


@pytest.fixture(scope="module")
def blocks_page(hooks):
    return hooks["blocks_page"]()


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


def test_every_block_has_its_parameters(blocks_page):
    for name, box in BOXES.items():
        section = blocks_page.partition(f"## `{name}` ")[2].partition("\n## ")[0]
        for block, config in zip(box.variants, box.configs, strict=True):
            own = section.partition(f"### {block.__name__} ")[2].partition("\n### ")[0]
            for field in config.__dataclass_fields__:
                assert f"| `{field}` |" in own, f"{block.__name__}.{field}"


def test_every_field_of_a_scenario_has_a_meaning_or_a_place(blocks_page):
    for field in dataclasses.fields(Scenario):
        assert f"`{field.name}`" in blocks_page, field.name
    for config in (SystemParameters, AircraftParameters, RunLimits, SceneConfig):
        for field in dataclasses.fields(config):
            assert f"| `{field.name}` |" in blocks_page, f"{config.__name__}.{field.name}"


def test_a_link_that_leads_nowhere_is_found(hooks, tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html#here">b</a><a href="b.html#gone">b</a><a href="c.html">c</a>'
        '<h2 id="top">a</h2><a href="#top">top</a><a href="https://example.org">out</a>'
        '<img src="no.png"/>'
    )
    (tmp_path / "b.html").write_text('<p id="here"><a href="a.html">a</a></p>')
    broken = ["a.html: b.html#gone", "a.html: c.html", "a.html: no.png"]
    assert hooks["broken_links"](tmp_path) == broken


def test_the_citation_and_the_changelog_have_the_version():
    root = DOCS.parent
    version = drake_nonstop.__version__
    assert yaml.safe_load((root / "CITATION.cff").read_text())["version"] == version
    assert re.search(r"(?m)^## (\S+)$", (root / "CHANGELOG.md").read_text())[1] == version


@pytest.mark.nightly("examples")
def test_every_box_of_the_figure_is_a_link(hooks):
    page = hooks["figure_page"]()
    for name in BOXES:
        assert f'<a href="blocks.html#{name}"><g data-block="{name}">' in page


def test_the_theory_names_functions_that_exist_of_every_module_with_equations():
    text = (DOCS / "theory.md").read_text(encoding="utf-8")
    folder = DOCS.parent / "drake_nonstop" / "mechanics"
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    named = {(m, f) for m, f in re.findall(r"`(\w+)\.(\w+)`", text) if m in modules}
    for module, function in named:
        own = importlib.import_module(f"drake_nonstop.mechanics.{module}")
        assert hasattr(own, function), f"{module}.{function}"
    algebra = {"rotation", "signals", "signal_layouts"}
    assert modules - algebra == {module for module, _ in named}


def test_every_page_is_in_the_navigation():
    text = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r": ([\w/]+\.(?:md|ipynb))$", text, re.MULTILINE))
    made = {"figure.md", "blocks.md", "signals.md", "reference.md"}
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    notebooks = {path.relative_to(DOCS).as_posix() for path in DOCS.glob("notebooks/*.ipynb")}
    assert named == pages | notebooks | made
    assert "\nstrict: true\n" in text
