"""Choices for the boxes of the figure: blocks, parameters and ports, for people to read.

All is taken from the code: the blocks from `BOXES`, a block's parameters from the dataclass
beside it, their meanings from the comments on its fields, and the ports from a block that is
built with the default scenario's model.
"""

import dataclasses
import inspect
from dataclasses import dataclass
from typing import Any

from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS
from drake_nonstop.loop.box import config_class
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import HELD
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.system import Model
from drake_nonstop.scenario.schema import PATTERN, PATTERNS, Scenario
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.systems import wiring
from drake_nonstop.systems.documentation import meanings
from drake_nonstop.validation import ScenarioError, require


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A field of a config: its type, its default as in YAML, and its unit and meaning."""

    name: str
    type: str
    default: str
    meaning: str


@dataclass(frozen=True, kw_only=True)
class Port:
    """A port and its size: a number, for n carriers "3n", for m coordinates "2m"."""

    name: str
    size: str
    is_optional: bool = False  # an output need not be there, an input need not be connected
    layout: Layout | None = None  # of a signal of the figure; None: it is not known, or no vector


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A block that a box can be, or a pattern, which has no ports.

    `unbuildable` says why the ports are not known: the defaults do not make a block.
    """

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    unbuildable: str = ""


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box of the figure, the signals that it has to make and its choices, the default first."""

    name: str
    signals: tuple[Port, ...]
    choices: tuple[Choice, ...]


def box_names() -> list[str]:
    """The names that `describe` takes: the figure's boxes, in its order, and the pattern."""
    return [*BOXES, PATTERN]


def describe(name: str) -> Box:
    """A box of the figure, or the pattern, with all that can be chosen for it.

    Raises:
        ScenarioError: there is no such box.
    """
    require(name in box_names(), "box", name, f"give one of {', '.join(box_names())}")
    if name == PATTERN:
        choices = tuple(_choice(config, config, None) for config in PATTERNS)
        return Box(name=name, signals=(), choices=choices)
    scenario = Scenario()
    # For blocks of aircraft; it changes no port of the others.
    system = dataclasses.replace(scenario.system, aircraft=AircraftParameters(model="rascal_110"))
    model = Model(system, scenario.pattern, scenario.control_period)
    return Box(
        name=name,
        signals=tuple(_port(signal, None) for signal in BOXES[name].signals),
        choices=tuple(_choice(config_class(b), b, model) for b in BOXES[name].variants),
    )


def parameters(config: type) -> tuple[Parameter, ...]:
    """The fields of a config class, in order."""
    about = meanings(config)
    default = config()
    return tuple(
        Parameter(
            name=field.name,
            type=field.type.__name__ if type(field.type) is type else str(field.type),
            default=_shown(getattr(default, field.name)),
            meaning=about.get(field.name, ""),
        )
        for field in dataclasses.fields(config)
    )


def _choice(config: type, block: type, model: Model | None) -> Choice:
    """A block and its config, with its ports if there is a model to build it with."""
    ports: dict[str, Any] = {}
    if model is not None:
        try:
            built = block(model)
        except ScenarioError as error:
            ports["unbuildable"] = str(error)
        else:
            optional = wiring.optional_inputs(built)
            read = wiring.input_sizes(built).items()
            ports["inputs"] = tuple(_port(*port, port[0] in optional) for port in read)
            ports["outputs"] = tuple(_port(*port) for port in wiring.output_sizes(built).items())
    name = config.__name__.removesuffix("Config")
    summary = (inspect.getdoc(block) or "").partition("\n")[0]
    return Choice(name=name, summary=summary, parameters=parameters(config), **ports)


def _port(name: str, size: int | None, is_optional: bool | None = None) -> Port:
    """The port of that name: its size by the contract, or else as it is for the default n."""
    layout = SIGNALS.get(name.removeprefix(HELD))
    if is_optional is None:
        is_optional = any(name in box.optional for box in BOXES.values())
    text = "abstract" if size is None else str(size)
    text = text if layout is None else layout.size
    return Port(name=name, size=text, is_optional=is_optional, layout=layout)


def _shown(value: Any) -> str:
    """The value as it may stand in a scenario, in one line; nothing for a part with fields."""
    is_part = dataclasses.is_dataclass(value) or hasattr(value, "__fields__")
    return "" if is_part else dump_plain(value)
