"""What the boxes of the figure can be: their blocks, parameters and ports, for people to read.

All is taken from the code: the blocks from `BOXES`, a block's parameters from the dataclass
beside it, their meanings from the comments on its fields, and the ports from a block that is
built with the default scenario's model.
"""

import dataclasses
import inspect
import math
from dataclasses import dataclass
from typing import Any

import yaml
from pydrake.systems.framework import System

from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS
from drake_nonstop.loop.box import config_class
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.system import Model
from drake_nonstop.scenario.schema import PATTERN, PATTERNS, Scenario
from drake_nonstop.systems import wiring
from drake_nonstop.systems.field_comments import meanings
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
        choices = tuple(map(_pattern, PATTERNS))
        return Box(name=name, signals=(), choices=choices)
    scenario = Scenario()
    # For blocks of aircraft; it changes no port of the others.
    system = dataclasses.replace(scenario.system, aircraft=AircraftParameters(model="rascal_110"))
    model = Model(system, scenario.pattern, scenario.control_period)
    return Box(
        name=name,
        signals=tuple(_port(signal, None) for signal in BOXES[name].signals),
        choices=tuple(_choice(block, model) for block in BOXES[name].variants),
    )


def parameters(config: type) -> tuple[Parameter, ...]:
    """The fields of a config class, in order."""
    about = meanings(config)
    default = config()
    return tuple(
        Parameter(
            name=field.name,
            type=_type_name(field.type),
            default=_as_yaml(getattr(default, field.name)),
            meaning=about.get(field.name, ""),
        )
        for field in dataclasses.fields(config)
    )


def _choice(block: type[System], model: Model) -> Choice:
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    unbuildable = ""
    try:
        built: Any = block(model)
    except ScenarioError as error:
        unbuildable = str(error)
    else:
        optional = wiring.optional_inputs(built)
        inputs = tuple(
            dataclasses.replace(_port(*item), is_optional=item[0] in optional)
            for item in wiring.input_sizes(built).items()
        )
        outputs = tuple(_port(*item) for item in wiring.output_sizes(built).items())
    return Choice(
        name=block.__name__,
        summary=_summary(block),
        parameters=parameters(config_class(block)),
        inputs=inputs,
        outputs=outputs,
        unbuildable=unbuildable,
    )


def _pattern(config: type) -> Choice:
    return Choice(
        name=config.__name__.removesuffix("Config"),
        summary=_summary(config),
        parameters=parameters(config),
    )


def _port(name: str, size: int | None) -> Port:
    """The port of that name: its size by the contract, or else as it is for the default n."""
    layout = SIGNALS.get(name)
    is_optional = any(name in box.optional for box in BOXES.values())
    text = "abstract" if size is None else str(size)
    return Port(
        name=name,
        size=text if layout is None else layout.size,
        is_optional=is_optional,
        layout=layout,
    )


def _summary(documented: type) -> str:
    """The first line of the docstring."""
    return (inspect.getdoc(documented) or "").partition("\n")[0]


def _type_name(annotation: Any) -> str:
    return annotation.__name__ if type(annotation) is type else str(annotation)


def _as_yaml(value: Any) -> str:
    """The value as it may stand in a scenario, in one line."""
    try:
        text = yaml.dump(
            value, Dumper=_Dumper, default_flow_style=True, allow_unicode=True, width=math.inf
        )
    except yaml.representer.RepresenterError:  # neither a number nor a text nor a list of those
        text = str(value)
    return text.removesuffix("...\n").strip()


class _Dumper(yaml.SafeDumper):
    """Writes out what stands there twice."""

    def ignore_aliases(self, data: Any) -> bool:
        """No anchors and aliases."""
        return True
