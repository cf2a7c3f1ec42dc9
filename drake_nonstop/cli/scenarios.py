"""`drake-nonstop list`: list the scenarios.

`drake-nonstop blocks`: list what each box of the figure can be, with its parameters and ports.
`drake-nonstop new`: write a scenario file to start from, with every field, unit and meaning.
`drake-nonstop schema`: write a JSON Schema of scenario files, by which editors check them.
"""

import argparse
import json
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_trust
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.scenario.choices import CHOICES
from drake_nonstop.scenario.describe import (
    Parameter,
    choices_of,
    commented_scenario,
    scenario_schema,
    size_of,
)
from drake_nonstop.scenario.loading import load_scenario, parse_scenario, scenario_names
from drake_nonstop.studies.files import replacing_file, require_writable_file
from drake_nonstop.validation import ScenarioError, require

_LINE_WIDTH = 100  # characters
_MAX_COLUMN_WIDTH = 30  # characters


def add_to(commands: Commands) -> None:
    """Adds the subcommands."""
    parser = commands.add_parser("list", help="list the scenarios")
    parser.set_defaults(action=_list)
    parser = commands.add_parser(
        "blocks", help="what each box of the figure can be: blocks, parameters, ports"
    )
    parser.set_defaults(action=_blocks)
    parser.add_argument("box", nargs="?", metavar="BOX", help="only this box, such as phase")
    parser = commands.add_parser(
        "new", help="write a scenario file to start from, with every field, unit and meaning"
    )
    parser.set_defaults(action=_new)
    parser.add_argument(
        "file", type=Path, metavar="NAME[.yaml]", help="the scenario's name, and that of its file"
    )
    parser.add_argument(
        "--from",
        dest="base",
        default="quintic",
        metavar="NAME|FILE.yaml",
        help="the scenario that it copies (quintic)",
    )
    add_trust(parser, "let that one import blocks of your own")
    parser = commands.add_parser(
        "schema",
        help="write a JSON Schema of scenario files, by which editors complete and check them",
        description="Writes a JSON Schema. An editor with YAML's language server uses it for files "
        "that begin with `# yaml-language-server: $schema=FILE`; its setting `yaml.customTags` has "
        "to be the list under that key of the schema.",
    )
    parser.set_defaults(action=_schema)
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: it is printed")


def _list(options: argparse.Namespace) -> int:
    names = scenario_names()
    width = max(len(name) for name in names)
    for name in names:
        print(f"{name:{width}}  {load_scenario(name).description}")
    return 0


def _blocks(options: argparse.Namespace) -> int:
    names = [*CHOICES] if options.box is None else [options.box]
    told = {name: choices_of(name) for name in names}
    print("Sizes are in brackets, for n carriers and m internal-force coordinates.")
    for name, choices in told.items():
        print()
        box = BOXES.get(name)
        if box is None:
            print(name)
        else:
            needed = _sizes(signal for signal in box.signals if signal not in box.optional)
            optional = _sizes(box.optional)
            made = "; ".join(filter(None, [needed, f"optional {optional}" if optional else ""]))
            _print_wrapped(made, f"{name} -> ")
            for signal, layout in box.signals.items():
                if layout is not None:
                    _print_wrapped(str(layout), f"    {signal} = ")
        for i, choice in enumerate(choices):
            print(f"\n  {choice.name}{' (default)' if i == 0 else ''}")
            _print_wrapped(choice.summary, "    ")
            for label, ports in (("in", choice.reads), ("out", choice.makes)):
                if ports:
                    _print_wrapped(ports, f"    {label:3}  ")
            _print_parameters(choice.parameters)
    return 0


def _sizes(signals: Iterable[str]) -> str:
    return ", ".join(f"{name} ({size_of(name)})" for name in signals)


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


def _new(options: argparse.Namespace) -> int:
    path: Path = options.file
    require(path.name, "NAME", path, "give the name of a file")
    if not path.suffix:
        path = path.with_name(f"{path.name}.yaml")
    require(path.suffix in (".yaml", ".yml"), "NAME", path, "give a name that ends in .yaml")
    scenario = load_scenario(options.base, trust=options.trust)
    text = commented_scenario(scenario, path.stem)
    parse_scenario(text, str(path), trust=options.trust)  # refuses a stem that names no scenario
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise ScenarioError(f"NAME = {path}: it exists; give another name") from None
    except OSError as error:
        remedy = f"give a file that can be written ({error.strerror})"
        raise ScenarioError(f"NAME = {path}: {remedy}") from None
    print(f"{path}: change it, and run it by `drake-nonstop run {path}`")
    return 0


def _schema(options: argparse.Namespace) -> int:
    text = json.dumps(scenario_schema(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    if options.out is None:
        sys.stdout.write(text)
        return 0
    require_writable_file(options.out)
    with replacing_file(options.out) as file:
        file.write(text.encode())
    print(f"written: {options.out}")
    return 0
