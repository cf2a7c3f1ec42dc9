"""Pages that are made from the code: the figure, its blocks and signals, and the reference."""

import html
import inspect
import re
from typing import Any

import drake_nonstop
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS, make_nonstop
from drake_nonstop.scenario.describe import box_names, describe
from drake_nonstop.visualization.drawing import draw_diagram


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages."""
    from mkdocs.structure.files import File

    pages = {
        "figure.md": figure_page(),
        "blocks.md": blocks_page(),
        "signals.md": signals_page(),
        "reference.md": reference_page(),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def figure_page() -> str:
    """The figure as it is drawn from the built diagram; each box leads to its blocks."""
    drawing = draw_diagram(make_nonstop(drake_nonstop.load_scenario("quintic")))
    drawing = drawing[drawing.index("<svg") :]

    def linked(match: re.Match[str]) -> str:
        name = match[2]
        place = f"blocks.html#{name}" if name in BOXES else "reference.html#SampleAndHold"
        return f'<a href="{place}">{match[0]}</a>'

    drawing = re.sub(r'(<g [^>]*data-block="([^"]+)".*?</g>)', linked, drawing, flags=re.DOTALL)
    rows = [
        f"| [`{name}`](blocks.md#{name}) | {box.variants[0].__name__} | "
        f"{_sentence(box.variants[0])} | {', '.join(map(_signal_link, box.signals))} |"
        for name, box in BOXES.items()
    ]
    return "\n".join(
        [
            "# The figure, box by box",
            "",
            "The control figure, drawn from the diagram that is built. Each box is a Drake system",
            "with named ports, and a link to what it can be.",
            "",
            f'<div class="figure" markdown="0">{drawing}</div>',
            "",
            "| box | default | what it does | signals that it makes |",
            "| --- | --- | --- | --- |",
            *rows,
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
    for name in box_names():
        box = describe(name)
        lines += ["", f"## `{name}` {{: #{name} }}"]
        if box.signals:
            made = ", ".join(f"{_signal_link(port.name)} ({port.size})" for port in box.signals)
            lines += ["", f"Makes {made}."]
        for choice in box.choices:
            lines += [
                "",
                f"### {choice.name} {{: #{name}-{choice.name} }}",
                "",
                _escaped(choice.summary),
            ]
            for label, ports in (("Reads", choice.inputs), ("makes", choice.outputs)):
                if ports:
                    texts = (f"`{p.name}` ({p.size})" for p in ports)
                    lines += ["", f"{label} {', '.join(texts)}."]
            if choice.parameters:
                lines += [
                    "",
                    "| parameter | type | default | unit and meaning |",
                    "| --- | --- | --- | --- |",
                ]
                lines += [
                    f"| `{p.name}` | {_cell(p.type)} | `{_cell(p.default)}` | {_cell(p.meaning)} |"
                    for p in choice.parameters
                ]
    return "\n".join([*lines, ""])


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
        "`drake_nonstop/mechanics/signal_layouts.py`.",
    ]
    for signal, layout in sorted(SIGNALS.items()):
        lines += ["", f"## `{signal}` {{: #{signal} }}", ""]
        maker = makers[signal]
        made = f"Made by [`{maker}`](blocks.md#{maker})"
        if layout is None:
            lines.append(f"{made}. No vector: a `ReferencePreview`, which tells the motion ahead.")
            continue
        lines += [f"{made}; {layout.size} entries.", "", "| part | size | unit | frame | |"]
        lines += ["| --- | --- | --- | --- | --- |"]
        lines += [
            f"| {part.name} | {part.size} | {part.unit} | {part.frame} | {_cell(part.meaning)} |"
            for part in layout.parts
        ]
    return "\n".join([*lines, ""])


def reference_page() -> str:
    """Every public name, by its docstring."""
    lines = [
        "# Reference",
        "",
        "Every name that `import drake_nonstop` offers, in the order of the figure.",
    ]
    for name in drake_nonstop.__all__:
        value = getattr(drake_nonstop, name)
        module = getattr(value, "__module__", None)
        if name.startswith("__") or module is None:
            continue
        if getattr(value, "__name__", name) != name:
            lines += ["", f"### {name}", "", f"Another name of `{value.__name__}`."]
        elif inspect.isclass(value) or inspect.isfunction(value):
            lines += ["", f"::: {module}.{name}"]
        else:
            lines += ["", f"### {name}", "", _escaped(inspect.getdoc(value) or "")]
    return "\n".join([*lines, ""])


def _signal_link(name: str) -> str:
    return f"[`{name}`](signals.md#{name})"


def _sentence(block: type) -> str:
    return _cell((inspect.getdoc(block) or "").partition("\n")[0])


def _cell(text: str) -> str:
    return _escaped(text).replace("|", "\\|").replace("\n", " ")


def _escaped(text: str) -> str:
    return html.escape(text, quote=False)
