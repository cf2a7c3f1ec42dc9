"""Pages that are made from the code: the figure, its blocks and signals.

What is built is checked by `tests/site_pages.py`, also links that MkDocs does not know, as in
notebooks.
"""

import atexit
import html
import inspect
import os
import re
import shutil
import tempfile
import textwrap
import typing
from pathlib import Path
from typing import Any

import drake_nonstop
from drake_nonstop.blocks.reference_governor import ReferenceGovernorConfig
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS, make_blocks, make_nonstop
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.run.metrics import HIGHER, LOWER, METRICS, compute_metrics
from drake_nonstop.scenario.choices import CHOICES
from drake_nonstop.scenario.describe import Parameter, choices_of, parameters, size_of
from drake_nonstop.scenario.obstacles import Obstacle
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.view.drawing import draw_diagram


def on_startup(command: str, dirty: bool) -> None:
    """Has the notebooks' kernels print errors alone, and not that their ports are local ones."""
    folder = tempfile.mkdtemp(prefix="drake-nonstop-docs-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    settings = Path(folder) / "profile_default" / "ipython_kernel_config.py"
    settings.parent.mkdir()
    settings.write_text('get_config().IPKernelApp.log_level = "ERROR"')
    os.environ["IPYTHONDIR"] = folder


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages."""
    from mkdocs.structure.files import File

    pages = {
        "figure.md": figure_page(),
        "scenario.md": scenario_page(),
        "signals.md": signals_page(),
        "metrics.md": metrics_page(),
        **box_pages(),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Notebooks with links to the built pages, and without views of processes that have ended."""
    if page.file.src_uri.endswith(".ipynb"):
        output = re.sub(r'<iframe [^>]*src="http://localhost.*?</iframe>', "", output)
        return re.sub(r'href="((?:\.\./)?\w+)\.md(["#])', r'href="\1.html\2', output)
    return output


THEORY = Path(__file__).with_name("theory.md")
# Pages that show how to write a block for a box from nothing.
HOW_TO = {"optimization_layer": "howto_optimizer.md", "carrier_dynamics": "howto_vehicle.md"}


def figure_page() -> str:
    """The figure as it is drawn from the built diagram; each box leads to its page."""
    drawing = draw_diagram(make_nonstop(drake_nonstop.load_scenario("quintic")))
    drawing = drawing[drawing.index("<svg") :]

    def linked(match: re.Match[str]) -> str:
        name = match[2]
        place = "reference/package_blocks.html"
        place += "#drake_nonstop.blocks.sample_and_hold.add_sample_and_hold"
        if name in BOXES:
            place = f"boxes/{name}.html"
        return f'<a href="{place}">{match[0]}</a>'

    drawing = re.sub(r'(<g [^>]*data-block="([^"]+)".*?</g>)', linked, drawing, flags=re.DOTALL)
    rows = [
        f"| [`{name}`](boxes/{name}.md) | {box.variants[0].__name__} | "
        f"{_sentence(box.variants[0])} | {', '.join(map(_signal_link, box.signals))} |"
        for name, box in BOXES.items()
    ]
    return "\n".join(
        [
            "---",
            "hide: [toc]",
            "---",
            "",
            "# The figure, box by box",
            "",
            "The control figure, drawn from the diagram that is built. Each box is a Drake system",
            "with named ports, and a link to its equations and blocks; wires have the names of",
            "signals and the paper's symbols.",
            "",
            f'<div class="figure" markdown="0">{drawing}</div>',
            "",
            '<div class="boxes" markdown>',
            "",
            "| box | default | what it does | signals that it makes |",
            "| --- | --- | --- | --- |",
            *rows,
            "",
            "</div>",
            "",
        ]
    )


def box_pages() -> dict[str, str]:
    """A page for each box of the figure: equations, a template, blocks with their parameters."""
    blocks = make_blocks(drake_nonstop.load_scenario("quintic"))
    return {f"boxes/{name}.md": box_page(name, blocks[name]) for name in BOXES}


def box_page(name: str, block: Any) -> str:
    """The page of a box, with a template whose signals are those of the block."""
    variants = BOXES[name].variants
    signals = BOXES[name].signals
    made = ", ".join(f"{_signal_link(port, '../')} ({size_of(port)})" for port in signals)
    lines = [f"# `{name}`", "", _sentence(variants[0]), "", f"The box makes {made}. Sizes are in"]
    lines += ["brackets, for n carriers and m coordinates of the internal force.", ""]
    lines += ["## Equations", "", *equations_of({v.__name__ for v in variants})]
    lines += ["## A block of your own", "", "Save this, change `equations`, and fly it:", ""]
    lines += ["```python", template(name, block), "```", ""]
    nothing = HOW_TO.get(name, "swap.md#a-block-of-your-own")
    lines += [f"One that inherits from none of these is [written from nothing](../{nothing}).", ""]
    for variant, choice in zip(variants, choices_of(name), strict=True):
        lines += [f"::: {variant.__module__}.{variant.__name__}", "    options: {members: false}"]
        if choice.parameters:
            head = f"### Parameters of {choice.name} {{: #{choice.name}-parameters }}"
            lines += ["", head, *_table(choice.parameters), ""]
    return "\n".join(lines)


def equations_of(blocks: typing.Collection[str]) -> list[str]:
    """The formulas of the page on the theory that these blocks compute, with links to the page."""
    lines, title, place = [], "", ""
    text = THEORY.read_text(encoding="utf-8")
    title_or_formula = r"^#+ (?P<title>.+)$|(?P<formula>^\$\$\n(?:.+\n)+?\$\$$)"
    pattern = rf"(?m){title_or_formula}|(?P<by>(?:^.+\n)+)\{{: \.computed-by \}}"
    formulas: list[str] = []
    for match in re.finditer(pattern, text):
        if match["title"]:
            title, formulas = match["title"], []
            place = re.sub(r"[^\w\s-]", "", title.lower()).strip().replace(" ", "-")
        elif match["formula"]:
            formulas.append(match["formula"])
        else:
            if {*re.findall(r"`(\w+)`", match["by"])} & {*blocks}:
                where = f"*[{title}](../theory.md#{place})*"
                lines += [where, "", *(f"{each}\n" for each in formulas), match["by"].rstrip()]
                lines += ["{: .computed-by }", ""]
            formulas = []
    return lines


def template(name: str, block: Any) -> str:
    """A block of one's own that begins as this one of a box, and a flight with it."""
    equations, kind = block.equations_of_block, type(block).__name__
    reads = [*equations.inputs, *equations.quantities]
    makes = [n for n in equations.results if n.isidentifier()]
    state = ["state"] if len(equations.state) else []
    told = f"# Takes {', '.join(state + reads) or 'no signals'}; returns "
    told += ", ".join((["the state's rate"] if state else []) + makes) + "."
    comment = textwrap.fill(
        told, 84, initial_indent=8 * " ", subsequent_indent=8 * " " + "# ", break_on_hyphens=False
    )
    return f"""\
from drake_nonstop import load_scenario, simulate
from {type(block).__module__} import {kind}


class Own{kind}({kind}):
    @staticmethod
    def equations(*signals, **parameters):
{comment}
        return {kind}.equations(*signals, **parameters)


run = simulate(load_scenario("quintic"), {name}=Own{kind})"""


def scenario_page() -> str:
    """The fields of a scenario that are no blocks."""
    lines = [
        "# Fields of a scenario",
        "",
        "Besides the blocks of [the boxes](figure.md) a scenario has these fields.",
        "`drake-nonstop blocks` prints what a box can be, with its parameters.",
        "",
        "## `pattern` {: #pattern }",
    ]
    for choice in choices_of("pattern"):
        lines += ["", f"### {choice.name} {{: #pattern-{choice.name} }}", ""]
        lines += [_escaped(choice.summary), *_table(choice.parameters)]
    lines += ["", "## `obstacles` {: #obstacles }", "", "A list of these:"]
    for shape in typing.get_args(Obstacle):
        tag = shape.__name__.removesuffix("Config")
        lines += ["", f"### `!{tag}` {{: #{tag} }}", "", inspect.cleandoc(shape.__doc__ or "")]
        lines += _table(parameters(shape))
    for name, config in _OTHER_PARTS.items():
        summary = _escaped(inspect.cleandoc(config.__doc__ or "").partition("\n\n")[0])
        lines += ["", f"## `{name}` {{: #{name} }}", "", summary, *_table(parameters(config))]
    elsewhere = {*CHOICES, *_OTHER_PARTS, "simulated", "simulator_config"}
    plain = [p for p in parameters(Scenario) if p.name not in elsewhere]
    head = (
        "Fields of the scenario itself. Besides, `simulated` has those fields of `system` that "
        "differ in the simulated plant, and `simulator_config` those of Drake's `SimulatorConfig`."
    )
    lines += ["", "## The scenario {: #scenario }", "", head, *_table(plain)]
    return "\n".join([*lines, ""])


# Parts of a scenario that are no boxes; those of `scene` and others are in `CHOICES`, too.
_OTHER_PARTS = {
    "system": SystemParameters,
    "system.aircraft": AircraftParameters,
    "reference_governor": ReferenceGovernorConfig,
    "limits": RunLimits,
    "scene": SceneConfig,
}


def _table(of: typing.Sequence[Parameter]) -> list[str]:
    """A table of parameters; nothing where there are none."""
    if not of:
        return []
    head = ["", "| parameter | type | default | unit and meaning |", "| --- | --- | --- | --- |"]
    return head + [
        f"| `{p.name}` | {_cell(p.type)} | `{_cell(p.default)}` | {_cell(p.meaning)} |" for p in of
    ]


def signals_page() -> str:
    """The layout of each signal of the figure."""
    makers = {signal: name for name, box in BOXES.items() for signal in box.signals}
    lines = [
        "# Signal dictionary",
        "",
        "Every signal between the boxes: what its entries are, in their order. Logs, tables, plots",
        "and exports name them `signal.part.carrier.component`, such as",
        "`carrier_state.positions.2.x`, for n carriers and m coordinates of the internal force.",
        "All units are SI. W is the world, L the load. Quaternions are w, x, y, z. A block of your",
        "own may declare the layouts of its ports as `signal_layouts`, see",
        "[Use runs in other tools](howto_data.md#signals-of-your-own).",
    ]
    for signal, layout in sorted(SIGNALS.items()):
        lines += ["", f"## `{signal}` {{: #{signal} }}", ""]
        maker = makers[signal]
        made = f"Made by [`{maker}`](boxes/{maker}.md)"
        if layout is None:
            lines.append(f"{made}. No vector: a `ReferencePreview`, which tells the motion ahead.")
            continue
        lines += [f"{made}; {layout.size} entries.", "", "| part | size | unit | frame | meaning |"]
        lines += ["| --- | --- | --- | --- | --- |"]
        lines += [
            f"| {part.name} | {part.size} | {part.unit} | {part.frame} | {_cell(part.meaning)} |"
            for part in layout.parts
        ]
    return "\n".join([*lines, ""])


# What the metrics of each group are measured from, by the first part of their paths.
_GROUPS = {
    "": "How the run ended, see [outcomes](start.md#outcomes), and how long it took.",
    "simulator": "The longest step of the integrator.",
    "load": """Errors of the load's true pose against its reference. The delay of the reference is
        that of a reference governor.""",
    "carriers": "Of all carriers; a list has a value for each. The bound is ε at the end.",
    "cables": """Tensions at the load. A cable is slack where it does not pull. The distance of two
        cables is that of their closest points.""",
    "bowed_cables": "Of cables with nodes: a node's distance from the line between the ends.",
    "obstacles": "Of scenarios with obstacles. `approaches` has a sentence for each obstacle.",
    "aircraft": """Of the simulated aircraft, over all of them. An airspeed is compared with the
        stall speed in level flight, and with that of a wing that carries cable and bank. A command
        is saturated where it is at a limit of the aircraft. The energy is that of all batteries
        while the reference moves, per mass of the load and length of its way.""",
    "optimizer": """How many updates of the optimization layer ended in each way: `kept` left ξ and
        A as they were, `solved` found better ones within all limits, `relaxed` found none within
        all limits and took those that miss them least, and `held` found nothing better than the
        last ones. `solve_time_ms` has the median, the 99th percentile and the largest wall time of
        updates made in Python.""",
}


def metrics_page() -> str:
    """Every metric of a run, by groups."""
    about = inspect.cleandoc(compute_metrics.__doc__ or "").split("\n\n")[1]
    lines = [
        "# Metrics",
        "",
        "`metrics.json` of a run, `compute_metrics(run)` and the tables of studies have these",
        "numbers. A metric is named by its path, whose end is the unit of the stored value; tables",
        "show it in the unit below. Beside the metrics stand `scenario`, `versions`, `is_steered`,",
        "whether a user changed the run during the flight, and `half_step`, the result of",
        "`--verify-step`.",
        "",
        " ".join(about.split()),
    ]
    for group, about in _GROUPS.items():
        head = f"## `{group}`" if group else "## The run"
        lines += [
            "",
            head,
            "",
            " ".join(about.split()),
            "",
            "| metric | meaning | shown in | better |",
        ]
        lines.append("| --- | --- | --- | --- |")
        for metric in METRICS:
            first, dot, _ = metric.path.partition(".")
            if group == (first if dot else ""):
                better = {LOWER: "lower", HIGHER: "higher"}.get(metric.better, "")
                lines.append(f"| `{metric.path}` | {metric.label} | {metric.unit} | {better} |")
    return "\n".join([*lines, ""])


def _signal_link(name: str, root: str = "") -> str:
    return f"[`{name}`]({root}signals.md#{name})"


def _sentence(block: type) -> str:
    return _cell((inspect.getdoc(block) or "").partition("\n")[0])


def _cell(text: str) -> str:
    return _escaped(text).replace("|", "\\|").replace("\n", " ")


def _escaped(text: str) -> str:
    return html.escape(text, quote=False)
