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
import typing
from pathlib import Path
from typing import Any

import drake_nonstop
from drake_nonstop.blocks.reference_governor import ReferenceGovernorConfig
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS, make_nonstop
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.choices import CHOICES
from drake_nonstop.scenario.describe import Parameter, choices_of, parameters, size_of
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
        "blocks.md": blocks_page(),
        "signals.md": signals_page(),
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


# Where the page on the theory has the equations of boxes.
EQUATIONS = {
    "load_feedback": "estimates",
    "wrench_controller": "the-desired-wrench",
    "optimization_layer": "plans-over-a-horizon",
    "phase": "the-pattern",
    "internal_force": "the-pattern",
    "force_distribution": "the-grasp-matrix-and-internal-forces",
    "carrier_trajectory": "where-carriers-are",
    "carrier_controller": "the-carriers-own-loop",
    "carrier_dynamics": "the-carriers-own-loop",
    "cables": "what-a-cable-pulls-with",
    "wind": "wind",
    "wind_estimator": "an-estimate-of-the-wind",
    "load_plant": "how-the-load-moves",
}


def figure_page() -> str:
    """The figure as it is drawn from the built diagram; each box leads to its equations."""
    drawing = draw_diagram(make_nonstop(drake_nonstop.load_scenario("quintic")))
    drawing = drawing[drawing.index("<svg") :]

    def linked(match: re.Match[str]) -> str:
        name = match[2]
        place = "reference/package_blocks.html"
        place += "#drake_nonstop.blocks.sample_and_hold.add_sample_and_hold"
        if name in EQUATIONS:
            place = f"theory.html#{EQUATIONS[name]}"
        elif name in BOXES:  # it has none
            place = f"blocks.html#{name}"
        return f'<a href="{place}">{match[0]}</a>'

    drawing = re.sub(r'(<g [^>]*data-block="([^"]+)".*?</g>)', linked, drawing, flags=re.DOTALL)
    rows = [
        f"| [`{name}`](blocks.md#{name}) | {box.variants[0].__name__} | "
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
            "with named ports, and a link to its equations; wires have the names of signals and",
            "the paper's symbols. The table below has links to what a box can be.",
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


def blocks_page() -> str:
    """What each box can be: blocks, ports and parameters, as `drake-nonstop blocks` prints them."""
    lines = [
        "# Blocks and parameters",
        "",
        "What each box of the figure can be, the default first: `drake-nonstop blocks` prints the",
        "same. Sizes are in brackets, for n carriers and m coordinates of the internal force.",
    ]
    for name in CHOICES:
        lines += ["", f"## `{name}` {{: #{name} }}"]
        if name in BOXES:
            made = ", ".join(
                f"{_signal_link(port)} ({size_of(port)})" for port in BOXES[name].signals
            )
            lines += ["", f"Makes {made}."]
        for choice in choices_of(name):
            lines += [
                "",
                f"### {choice.name} {{: #{name}-{choice.name} }}",
                "",
                _escaped(choice.summary),
            ]
            for label, ports in (("Reads", choice.reads), ("Makes", choice.makes)):
                if ports:
                    lines += ["", f"{label} {_escaped(ports)}."]
            lines += _table(choice.parameters)
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
        made = f"Made by [`{maker}`](blocks.md#{maker})"
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


def _signal_link(name: str) -> str:
    return f"[`{name}`](signals.md#{name})"


def _sentence(block: type) -> str:
    return _cell((inspect.getdoc(block) or "").partition("\n")[0])


def _cell(text: str) -> str:
    return _escaped(text).replace("|", "\\|").replace("\n", " ")


def _escaped(text: str) -> str:
    return html.escape(text, quote=False)
