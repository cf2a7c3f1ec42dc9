"""`drake-nonstop blocks`: what each box of the figure can be."""

import argparse
import textwrap
from collections.abc import Sequence

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.scenario.describe import Parameter, Port, box_names, describe

_LINE_WIDTH = 100  # characters
_MAX_COLUMN_WIDTH = 30  # characters


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "blocks", help="what each box of the figure can be: blocks, parameters, ports"
    )
    parser.set_defaults(action=_blocks)
    parser.add_argument("box", nargs="?", metavar="BOX", help="this one only, such as phase")


def _blocks(options: argparse.Namespace) -> int:
    names = box_names() if options.box is None else [options.box]
    boxes = [describe(name) for name in names]
    print("Sizes are in brackets, for n carriers and m internal-force coordinates.")
    for box in boxes:
        needed = _ports([port for port in box.signals if not port.is_optional])
        optional = _ports([port for port in box.signals if port.is_optional])
        kinds = [needed, f"optional {optional}" if optional else ""]
        made = "; ".join(filter(None, kinds))
        print()
        _print_wrapped(made, f"{box.name}{' -> ' if made else ''}")
        for port in box.signals:
            if port.layout is not None:
                parts = "; ".join(map(str, port.layout.parts))
                _print_wrapped(parts, f"    {port.name} = ")
        for i, choice in enumerate(box.choices):
            print(f"\n  {choice.name}{' (default)' if i == 0 else ''}")
            _print_wrapped(choice.summary, "    ")
            for label, ports in (("in", choice.inputs), ("out", choice.outputs)):
                if ports:
                    text = _ports(ports, says_optional=label == "in")
                    _print_wrapped(text, f"    {label:3}  ")
            if choice.unbuildable:
                _print_wrapped(f"not with its defaults: {choice.unbuildable}", "    ")
            _print_parameters(choice.parameters)
    return 0


def _ports(ports: Sequence[Port], says_optional: bool = False) -> str:
    return ", ".join(
        f"{port.name} ({port.size}{', optional' if says_optional and port.is_optional else ''})"
        for port in ports
    )


def _print_parameters(parameters: Sequence[Parameter]) -> None:
    """A line for each parameter, its unit and meaning in a column of their own.

    A name, type or default that is wider than a column pushes them to the next line.
    """
    widths = [
        max((len(text) for text in column if len(text) <= _MAX_COLUMN_WIDTH), default=0)
        for column in zip(*((p.name, p.type, p.default) for p in parameters), strict=True)
    ]
    for parameter in parameters:
        cells = (parameter.name, parameter.type, parameter.default)
        start = "".join(f"{cell:{width}}  " for cell, width in zip(cells, widths, strict=True))
        start, indent = f"    {start}", sum(widths) + 10
        if len(start) > indent:
            print(start.rstrip())
            start = " " * indent
        _print_wrapped(parameter.meaning, start)


def _print_wrapped(text: str, start: str) -> None:
    """The text after its start, in lines that fit, the later ones below the first's text."""
    lines = textwrap.wrap(text, _LINE_WIDTH - len(start), break_on_hyphens=False) or [""]
    for line in lines:
        print(f"{start}{line}".rstrip())
        start = " " * len(start)
