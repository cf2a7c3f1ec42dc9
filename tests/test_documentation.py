"""The pages that are made from the code have all of it; `make docs` checks their links."""

import dataclasses
import importlib
import json
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import get_args, get_type_hints

import numpy as np
import pytest
import yaml
from helpers import nightly_beyond
from registries import BOXES, CHOICES, METRICS
from site_pages import LARGEST_PAGE, faults

import drake_nonstop
from drake_nonstop import Scenario, load_scenario, record_replay, simulate

DOCS = Path(__file__).parents[1] / "docs"


def names_of(script):
    names = {"__name__": script, "__file__": str(DOCS / script)}
    exec(compile((DOCS / script).read_text(encoding="utf-8"), script, "exec"), names)
    return names


@pytest.fixture(scope="module")
def hooks():
    return names_of("hooks.py")


@pytest.fixture(scope="module")
def box_pages(hooks):
    return hooks["box_pages"]()


def test_every_public_name_is_once_in_the_reference_and_in_its_index():
    script = names_of("reference_pages.py")
    pages = script["reference_pages"]()
    found = [
        name
        for text in pages.values()
        for name in re.findall(r"(?m)^(?:::: (?!.*mechanics\.\w+$).*\.|## )(\w+)", text)
    ]
    public = {name for name in drake_nonstop.__all__ if not name.startswith("__")}
    blocks = {variant.__name__ for box in BOXES.values() for variant in box.variants}
    assert sorted(found) == sorted(public - blocks)
    linked = dict(re.findall(r"\[`(\w+)`\]\(([\w/]+\.md)", script["index_page"]()))
    assert {*linked} >= public | blocks
    assert {*linked.values()} == {*pages} | {f"boxes/{name}.md" for name in BOXES}


def test_every_signal_has_its_layout(hooks):
    page = hooks["signals_page"]()
    signals = {name: layout for box in BOXES.values() for name, layout in box.signals.items()}
    for name, layout in signals.items():
        section = page.partition(f"## `{name}` ")[2].partition("\n## ")[0]
        assert section
        for part in layout.parts if layout is not None else ():
            assert f"| {part.name} | {part.size} | {part.unit} | {part.frame} |" in section


def test_a_box_leads_to_its_equations_and_each_of_its_blocks_to_its_parameters(box_pages):
    for name, box in BOXES.items():
        page = box_pages[f"boxes/{name}.md"]
        assert re.search(r"\]\(\.\./theory\.md#.*\n\n\$\$", page), name
        for block, config in zip(box.variants, box.configs, strict=True):
            own = page.partition(f"::: {block.__module__}.{block.__name__}\n")[2]
            own = own.partition("\n:::")[0]
            assert own
            for field in config.__dataclass_fields__:
                assert f"| `{field}` |" in own, f"{block.__name__}.{field}"


@pytest.mark.parametrize("name", nightly_beyond(3, "examples", reversed(BOXES)))
def test_the_block_to_start_from_flies_as_the_default(name, box_pages, tmp_path, monkeypatch):
    code = re.search(r"```python\n(.*?)```", box_pages[f"boxes/{name}.md"], re.DOTALL)[1]
    assert len(re.findall(r"(?m)^ *[^ #\n]", code)) <= 10
    code = code.replace('("quintic")', '("quintic", ["simulation_duration=0.1"])')
    (tmp_path / f"own_{name}.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    own = importlib.import_module(f"own_{name}").run
    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    run = simulate(scenario, **{name: BOXES[name].configs[0]()})
    assert own.engine.startswith("compiled")
    assert np.array_equal(own.signal("load_state"), run.signal("load_state"))


def dataclasses_in(kind):
    """All dataclasses that a value of a type may have in it."""
    if dataclasses.is_dataclass(kind):
        return {kind}.union(*map(dataclasses_in, get_type_hints(kind).values()))
    return set().union(*map(dataclasses_in, get_args(kind)))


def test_every_field_of_a_scenario_has_a_meaning_on_a_page(hooks, box_pages):
    """Of the scenario, of its parts, and of all that boxes, the pattern and obstacles can be."""
    pages = "\n".join([hooks["scenario_page"](), *box_pages.values()])
    rows = dict(re.findall(r"(?m)^(\| `\w+` \|.*\|) (.*) \|$", pages))
    places = {name: f"boxes/{name}.md" in box_pages or f"## `{name}" in pages for name in CHOICES}
    assert all(places.values()), places
    choices = {config for configs in CHOICES.values() for config in configs}
    for config in choices | dataclasses_in(Scenario) - {Scenario}:
        for field in dataclasses.fields(config):
            found = [row for row in rows if row.startswith(f"| `{field.name}` |")]
            assert found, f"{config.__name__}.{field.name}"
            assert all(rows[row] for row in found), f"{config.__name__}.{field.name}"
    for field in dataclasses.fields(Scenario):
        assert places.get(field.name) or f"`{field.name}`" in pages, field.name


def test_every_metric_is_explained_in_its_group(hooks):
    page = hooks["metrics_page"]()
    paths = re.findall(r"(?m)^\| `([\w.]+)` \| [^|]+ \|", page)
    assert sorted(paths) == sorted(metric.path for metric in METRICS)
    assert len({*paths}) == len(paths)


def test_faults_of_built_pages_are_found(tmp_path):
    """One page with a fault of each kind, and one without any."""
    (tmp_path / "a.html").write_text(
        '<a href="b.html#gone">b</a><a href="c.html">c</a><a href="https://example.org">out</a>'
        '<img alt="" src="large.png"/><script src="https://example.org/x.js"></script>'
        '<p id="top"><a href="#top">top</a></p>'
    )
    (tmp_path / "b.html").write_text('<h1 id="here">B</h1><a href="a.html#top">a</a>')
    (tmp_path / "large.png").write_bytes(bytes(LARGEST_PAGE))
    assert faults(tmp_path) == [
        "a.html: broken link: b.html#gone",
        "a.html: broken link: c.html",
        "a.html: no alt text: large.png",
        "a.html: loaded from elsewhere: https://example.org/x.js",
        "a.html: 1.50 MB",
    ]


def test_the_replays_of_the_first_page_and_of_notebooks_share_one_viewer(tmp_path):
    script = names_of("gallery.py")
    viewer = "x" * 1_000_001
    page, taken = script["without_viewer"](f"<body><script>{viewer}</script><script>1</script>")
    assert (page, taken) == ('<body><script src="viewer.js"></script><script>1</script>', viewer)
    shown = re.findall(r"\(replays/(\w+)\.html\)", (DOCS / "index.md").read_text(encoding="utf-8"))
    assert shown == [*script["REPLAYS"]]
    with pytest.raises(ValueError, match="does not begin with"):
        script["without_viewer"]("<script>1</script>")
    (tmp_path / "replays").mkdir()
    notebook = SimpleNamespace(file=SimpleNamespace(src_uri="notebooks/a.ipynb"))
    short = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
    frame = record_replay(simulate(load_scenario("line", short)))._repr_html_()
    shown = script["on_post_page"](frame, notebook, {"site_dir": str(tmp_path)})
    (name,) = re.findall(r'src="\.\./(replays/a_\d+\.html)"', shown)
    assert '<script src="viewer.js"></script>' in (tmp_path / name).read_text()
    assert "srcdoc" not in shown


def test_the_citation_and_the_changelog_have_the_version():
    root = DOCS.parent
    version = drake_nonstop.__version__
    assert yaml.safe_load((root / "CITATION.cff").read_text())["version"] == version
    assert re.search(r"(?m)^## (\S+)$", (root / "CHANGELOG.md").read_text())[1] == version


@pytest.mark.nightly("examples")
def test_every_box_of_the_figure_is_a_link(hooks):
    page = hooks["figure_page"]()
    for name in BOXES:
        assert f'<a href="boxes/{name}.html"><g data-block="{name}">' in page


def test_the_theory_names_functions_that_exist_of_every_module_with_equations():
    text = (DOCS / "theory.md").read_text(encoding="utf-8")
    folder = DOCS.parent / "drake_nonstop" / "mechanics"
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    named = {(m, f) for m, f in re.findall(r"`(\w+)\.(\w+)`", text) if m in modules}
    for module, function in named:
        own = importlib.import_module(f"drake_nonstop.mechanics.{module}")
        assert hasattr(own, function), f"{module}.{function}"
    algebra = {"rotation", "signals", "signal_layouts"}
    assert modules - algebra == {module for module, _ in named} - algebra


def test_formulas_can_be_typeset():
    node = shutil.which("node")
    if node is None:
        pytest.skip("install Node.js, which reads formulas as browsers do")
    pages = {path.name: path.read_text(encoding="utf-8") for path in DOCS.glob("*.md")}
    found = {
        name: [a or b for a, b in re.findall(r"(?s)\$\$(.*?)\$\$|\$([^\s$][^$\n]*)\$", text)]
        for name, text in pages.items()
        if "$$" in text
    }
    assert len(found["theory.md"]) > 100
    script = """
        const katex = require(process.argv[1]);
        for (const text of JSON.parse(process.argv[2]))
            katex.renderToString(text, { strict: "error" });
    """
    formulas = json.dumps([text.replace("\n", " ") for own in found.values() for text in own])
    call = [node, "-e", script, str(DOCS / "katex" / "katex.min.js"), formulas]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-600:]
