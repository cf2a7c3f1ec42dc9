"""Builds a Diagram from named blocks: wires follow from the names of the ports."""

from collections.abc import Collection, Iterator, Mapping
from itertools import pairwise
from typing import Any

from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    InputPort,
    InputPortIndex,
    OutputPort,
    PortDataType,
    System,
)

from drake_nonstop.mechanics.signal_layouts import HELD, SAMPLE_TIME
from drake_nonstop.systems.block import box_of, title
from drake_nonstop.validation import ScenarioError, listed, require

OUTSIDE = "outside"  # what wires call the diagram's own input ports

_HOLD_REMEDY = (
    f"a SampleAndHold makes {SAMPLE_TIME} and the {HELD}... signals of sampled controllers; add "
    "SampleAndHold(model) to the blocks of connect_by_name, call add_sample_and_hold of a builder, "
    "or make them with a control period of 0"
)

Sizes = Mapping[str, int | None]  # of ports or signals, by name; None: abstract-valued


class WiringError(ScenarioError):
    """The blocks do not make a complete diagram."""


def output_names(block: System) -> list[str]:
    """The names of the block's output ports, in order."""
    return list(output_sizes(block))


def input_names(block: System) -> list[str]:
    """The names of the block's input ports, in order."""
    return list(input_sizes(block))


def optional_inputs(block: System) -> set[str]:
    """The names of the block's input ports that may be left unconnected.

    They are those of its attribute `optional_inputs`, and of a Diagram those that lead to such
    ports of its subsystems only.
    """
    found = set(getattr(block, "optional_inputs", ()))
    if isinstance(block, Diagram):
        for i, name in enumerate(input_names(block)):
            readers = block.GetInputPortLocators(InputPortIndex(i))
            if name not in found and all(
                reader.get_input_port(index).get_name() in optional_inputs(reader)
                for reader, index in readers
            ):
                found.add(name)
    return found


def output_sizes(block: System) -> Sizes:
    """The sizes of the block's output ports, in order."""
    ports = [block.get_output_port(i) for i in range(block.num_output_ports())]
    return {port.get_name(): _size(port) for port in ports}


def input_sizes(block: System) -> Sizes:
    """The sizes of the block's input ports, in order."""
    ports = [block.get_input_port(i) for i in range(block.num_input_ports())]
    return {port.get_name(): _size(port) for port in ports}


def _size(port: InputPort | OutputPort) -> int | None:
    return port.size() if port.get_data_type() == PortDataType.kVectorValued else None


def check_outputs(name: str, block: System, required: Sizes, optional: Sizes) -> Sizes:
    """Checks the outputs of the block that goes by that name, and returns all of them.

    It may have others besides.

    Raises:
        WiringError: a required output is missing, or one of either kind has another size.
    """
    given = output_sizes(block)
    expected = {**optional, **required}
    lacks = required.keys() - given.keys()
    differs = any(given[port] != expected[port] for port in given.keys() & expected.keys())
    if lacks or differs:
        besides = f", optional {_listed(optional)}" if optional else ""
        raise WiringError(
            f"{name} = {type(block).__name__} with outputs {_listed(given)}: expected "
            f"{_listed(required)}{besides}; rename or resize the ports"
        )
    return given


def _listed(sizes: Sizes) -> str:
    """The ports or signals as "force (3), pose (7)"."""
    named = [f"{name} ({'abstract' if size is None else size})" for name, size in sizes.items()]
    return ", ".join(named) or "none"


def _remedy(wrong: Sizes, signals: Sizes) -> str:
    """Remedy for input ports that no signal can be connected to."""
    unknown = [name for name in wrong if name not in signals]
    if any(map(_is_of_hold, unknown)):
        return _HOLD_REMEDY
    if not unknown:
        return "rename or resize the ports"
    return f"rename or resize the ports, or give make_nonstop or connect_by_name inputs={unknown}"


def _expected(wrong: Sizes, signals: Sizes) -> str:
    """Conditions for input ports that no signal can be connected to."""
    expected = {name: signals[name] for name in wrong if name in signals}
    unknown = {name: size for name, size in wrong.items() if name not in signals}
    parts = [f"expected {_listed(expected)}"] if expected else []
    if unknown:
        parts.append(
            f"{_listed(unknown)} {'is' if len(unknown) == 1 else 'are'} not among the signals "
            f"{_listed(dict(sorted(signals.items())))}"
        )
    return " and ".join(parts)


def wires(blocks: Mapping[str, System], inputs: Collection[str] | Sizes = ()) -> list[str]:
    """The wires "block.port -> block.port" that the names of the ports imply.

    Those that `connect_by_name` makes. The wires of `inputs` come from "outside.port". Ports named
    in the attribute `optional_inputs` of a block have no wire where there is no such signal.

    Raises:
        WiringError: two blocks make the same signal, or an input names no signal, or one of
            another size, or an entry of `inputs` is made by a block, or read by none.
    """
    outside = sizes_of_inputs(blocks, inputs)
    sources: dict[str, str] = dict.fromkeys(outside, OUTSIDE)
    sizes: dict[str, int | None] = dict(outside)
    made = {name: output_sizes(block) for name, block in blocks.items()}
    read_by = {name: input_sizes(block) for name, block in blocks.items()}
    for block_name in blocks:
        for signal, size in made[block_name].items():
            if signal in outside:
                raise WiringError(
                    f"inputs = {signal}: {block_name} has an output port of that name; leave it "
                    "out of the inputs, or rename the port"
                )
            if signal in sources:
                raise WiringError(
                    f"{block_name}.{signal} = output: {sources[signal]} has an output port of "
                    "that name already; rename one of the two, or leave one of the blocks out"
                )
            sources[signal], sizes[signal] = block_name, size
    result = []
    for block_name, read in signals_read(blocks, sources).items():
        block, given = blocks[block_name], read_by[block_name]
        wrong = {
            port: given[port]
            for port, signal in read.items()
            if signal not in sources or sizes[signal] != given[port]
        }
        if wrong:
            raise WiringError(
                f"{block_name} = {type(block).__name__} with inputs {_listed(given)}: "
                f"{_expected(wrong, sizes)}; {_remedy(wrong, sizes)}"
            )
        result += [
            f"{sources[signal]}.{signal} -> {block_name}.{port}" for port, signal in read.items()
        ]
    return result


def signals_read(
    blocks: Mapping[str, System], sources: Mapping[str, str]
) -> dict[str, dict[str, str]]:
    """The signal that each input port is named after, or what is held of it, by names of blocks.

    `sources` are the names of the signals' makers. An optional input of no signal is left out.
    """
    held = {
        port: f"{HELD}{port}"
        for block in blocks.values()
        for port in input_names(block)
        if block.HasOutputPort(f"{HELD}{port}")
    }
    upstream = {sources.get(signal) for pair in held.items() for signal in pair}
    result = {}
    for name, block in blocks.items():
        replaced = {} if name in upstream else held
        optional = optional_inputs(block)
        result[name] = {
            port: replaced.get(port, port)
            for port in input_names(block)
            if port in sources or port not in optional
        }
    return result


def connect_remaining(builder: DiagramBuilder, *, of: System | None = None) -> None:
    """Connects inputs that are open yet to the signals of their names, as `connect_by_name` does.

    For a builder whose blocks are there, named or not, and some of them connected by hand. An
    input stays open where no block of the builder makes its signal: it can be exported, or
    connected, before or after.

    With `of`, one of its systems, only what leads to it or comes from it is connected.

    Raises:
        ScenarioError: the builder is built, two blocks make the signal of an open input, or its
            size is another one.
    """
    require_open(builder, "connect_remaining")
    blocks = {block.get_name(): block for block in builder.GetMutableSystems()}
    makers: dict[str, list[str]] = {}
    for name, block in blocks.items():
        for signal in output_names(block):
            makers.setdefault(signal, []).append(name)
    sources = {signal: names[0] for signal, names in makers.items()}
    for name, read in signals_read(blocks, sources).items():
        for port, signal in read.items():
            reader = blocks[name].GetInputPort(port)
            made = [blocks[maker] for maker in makers.get(signal, [])]
            is_asked = of is None or of is blocks[name] or of in made
            if not made or not is_asked or builder.IsConnectedOrExported(reader):
                continue
            if len(made) > 1:
                raise WiringError(
                    f"{title(made[1])}.{signal} = output: {title(made[0])} has an output port of "
                    f"that name already; rename one of the two, or connect {title(blocks[name])}."
                    f"{port} before"
                )
            source = made[0].GetOutputPort(signal)
            if _size(source) != _size(reader):
                raise WiringError(
                    f"{title(blocks[name])}.{port} = {_listed({port: _size(reader)})}: expected "
                    f"{_listed({signal: _size(source)})}; rename or resize the port"
                )
            builder.Connect(source, reader)


def sizes_of_inputs(
    blocks: Mapping[str, System], inputs: Collection[str] | Sizes
) -> dict[str, int | None]:
    """The sizes of signals from outside: as they are given, or as the first reader has them."""
    if isinstance(inputs, Mapping):
        return dict(inputs)
    remedy = 'give a list of signals that blocks read, such as ["wind_speed"]'
    sizes: dict[str, int | None] = {}
    for signal in listed("inputs", inputs, remedy):
        require(isinstance(signal, str), "inputs", signal, remedy)
        read = [given[signal] for given in map(input_sizes, blocks.values()) if signal in given]
        require(bool(read), "inputs", signal, remedy)
        sizes[signal] = read[0]
    return sizes


def connect_by_name(
    builder: DiagramBuilder,
    blocks: Mapping[str, System],
    *,
    inputs: Collection[str] | Sizes = (),
) -> None:
    """Adds blocks to a builder, wires them by the names of their ports, exports every signal.

    Each output port is a signal with a name of its own; an input port named after a signal is
    connected to it, and the diagram has an output port of that name. Where a block makes `held_x`
    of an input x, as `SampleAndHold` does, readers of x get `held_x` in its place; blocks that make
    x, or anything that is held, do not: what is upstream of a hold must not read from it.
    `make_nonstop` puts its figure together in this way.

    The blocks are added by the names that they get in the diagram. `inputs` are signals that no
    block makes: they become input ports of the diagram, each of the size of the port that reads it.

    Raises:
        ScenarioError: the builder is built, a name is none, two blocks make the same signal, or an
            input names no signal, or one of another size; the message names block and port, and
            lists the signals.
    """
    require_open(builder, "connect_by_name")
    remedy = 'give a mapping from names to blocks, such as {"estimator": Estimator(model)}'
    require(isinstance(blocks, Mapping), "blocks", blocks, remedy)
    for name, block in blocks.items():
        require_name("blocks", name)
        remedy = "give a LeafSystem or Diagram"
        require(isinstance(block, System), f"blocks.{name}", block, remedy)
        is_new = not builder.HasSubsystemNamed(name)
        require(is_new, "blocks", name, "the builder has a system of that name; give another one")
    planned = wires(blocks, inputs)
    for block_name, block in blocks.items():
        block.set_name(block_name)
        builder.AddSystem(block)
    exported = set()
    for wire in planned:
        (source, signal), target = (end.split(".", 1) for end in wire.split(" -> "))
        port = blocks[target[0]].GetInputPort(target[1])
        if source != OUTSIDE:
            builder.Connect(blocks[source].GetOutputPort(signal), port)
        elif signal in exported:
            builder.ConnectInput(signal, port)
        else:
            builder.ExportInput(port, signal)
            exported.add(signal)
    # Drake's FirstOrderTaylorApproximation takes the first output, and crashes where that depends
    # on no state, as the signals of a block without inputs.
    for block in sorted(blocks.values(), key=lambda block: block.num_input_ports() == 0):
        for signal in output_names(block):
            builder.ExportOutput(block.GetOutputPort(signal), signal)


def require_name(field: str, name: Any) -> None:
    """Raises ScenarioError for what cannot be the name of a block."""
    is_name = isinstance(name, str) and name and not {":", "."} & set(name)
    require(is_name, field, name, "name each block by a text without colons and dots")


def require_open(builder: DiagramBuilder, function: str) -> None:
    """Raises ScenarioError for what is no DiagramBuilder, or built before the function's call."""
    require(isinstance(builder, DiagramBuilder), "builder", builder, "give a DiagramBuilder")
    remedy = f"call {function} before builder.Build()"
    require(not builder.already_built(), "builder", "built", remedy)


def maker_of(diagram: Diagram, signal: str) -> System:
    """The subsystem with the output port that a diagram exports by that name."""
    return source_of(diagram.GetOutputPort(signal)).get_system()


def source_of(exported: OutputPort) -> OutputPort:
    """The port of a diagram's own subsystem that it exports."""
    maker, index = exported.get_system().get_output_port_locator(exported.get_index())
    return maker.get_output_port(index)


def ports_of(diagram: Diagram, signal: str) -> list[OutputPort]:
    """The ports that show a signal: that which the diagram exports by this name, or else all.

    Those of its subsystems, and in diagrams without such a port those of theirs.
    """
    if diagram.HasOutputPort(signal):
        return [source_of(diagram.GetOutputPort(signal))]
    found = []
    for part in diagram.GetSystems():
        if part.HasOutputPort(signal):
            found.append(part.GetOutputPort(signal))
        elif isinstance(part, Diagram):
            found += ports_of(part, signal)
    return found


def require_signals(
    diagram: Diagram, sizes: Sizes, field: str, *, is_exporting: bool = True
) -> None:
    """Checks that a diagram exports signals, or else that each is made once in it, however deep.

    `sizes` are those of the ports, None for any, and `field` is what the error calls the diagram.

    Raises:
        WiringError: it lacks some, they have other sizes, or two blocks make the same.
    """
    found = {
        signal: ports_of(diagram, signal)
        if diagram.HasOutputPort(signal) or not is_exporting
        else []
        for signal in sizes
    }
    wrong = [
        name
        for name, size in sizes.items()
        if not found[name] or size not in (None, found[name][0].size())
    ]
    if wrong:
        pairs = sizes.items()
        needed = ", ".join(name if size is None else f"{name} ({size})" for name, size in pairs)
        remedy = f"give it blocks that make {needed}, by ports of these names"
        if is_exporting:
            remedy = f"export {needed} by these names, as connect_by_name does"
        raise WiringError(
            f"{field} = {type(diagram).__name__} without output ports {', '.join(wrong)}: {remedy}"
        )
    for name, ports in found.items():
        if len(ports) > 1:
            makers = " and ".join(box_of(port.get_system()) for port in ports)
            raise WiringError(
                f"{field} = {type(diagram).__name__} where {makers} make {name}: export the loop's "
                "by this name, rename the port of the other, or give the diagram with one of them"
            )


def require_own_context(field: str, diagram: Diagram, context: Context) -> None:
    """Requires as `require_context` does, of a diagram of floats."""
    remedy = "give a Diagram of floats, such as make_nonstop builds; converted ones cannot be set"
    require(isinstance(diagram, Diagram), field, type(diagram).__name__, remedy)
    require_context(field, diagram, context)


def require_context(field: str, system: System, context: Context) -> None:
    """Raises ScenarioError unless the context, of that name in errors, is that of the system.

    Drake's own functions end the process where they copy states of other sizes.
    """
    remedy = "give a context, such as diagram.CreateDefaultContext()"
    require(isinstance(context, Context), field, type(context).__name__, remedy)
    try:
        system.ValidateContext(context)
    except RuntimeError:
        raise ScenarioError(
            f"{field} = a context of another system: give that of the diagram, inside of "
            "a bigger one diagram.GetMyMutableContextFromRoot(root)"
        ) from None


def nested(diagram: Diagram, signals: Collection[str]) -> list[Diagram]:
    """A diagram that makes signals, and those inside of it that make all of them.

    The outermost is the first, and no subsystem of the last makes all of them.
    """
    parts = [part for part in diagram.GetSystems() if isinstance(part, Diagram)]
    inner = next((part for part in parts if _makes(part, diagram, signals)), None)
    return [diagram] if inner is None else [diagram, *nested(inner, signals)]


def _makes(part: Diagram, diagram: Diagram, signals: Collection[str]) -> bool:
    """Whether all signals of a diagram come from ports of a part of it, or inside of that."""
    inside = {*systems_in(part)}
    return all(
        port.get_system() in inside and ports_of(part, signal)
        for signal in signals
        for port in ports_of(diagram, signal)
    )


def systems_in(system: System) -> Iterator[System]:
    """A system, and all systems inside of it, each followed by what is in it."""
    yield system
    for part in system.GetSystems() if isinstance(system, Diagram) else ():
        yield from systems_in(part)


def innermost(
    diagram: Diagram, context: Context, signals: Collection[str]
) -> tuple[Diagram, Context]:
    """The last of the diagrams that are `nested`, and its context in that of the first."""
    diagrams = nested(diagram, signals)
    for outer, inner in pairwise(diagrams):
        context = outer.GetMutableSubsystemContext(inner, context)
    return diagrams[-1], context


def unconnected(diagram: Diagram, context: Context) -> str:
    """A sentence that names the first input without a value of a diagram's blocks, if any."""
    for i in range(diagram.num_input_ports()):
        port = diagram.get_input_port(i)
        name = port.get_name()
        if not port.HasValue(context) and name not in optional_inputs(diagram):
            return f"{name} = no value: connect the diagram's input port, or fix its value"
    for block in diagram.GetSystems():
        own, optional = diagram.GetSubsystemContext(block, context), optional_inputs(block)
        for name in input_names(block):
            if name not in optional and not block.GetInputPort(name).HasValue(own):
                remedy = "connect it, or wire the blocks with connect_by_name or connect_remaining"
                remedy = _HOLD_REMEDY if _is_of_hold(name) else remedy
                return f"{title(block)}.{name} = not connected: {remedy}"
    for block in diagram.GetSystems():
        if type(block) is Diagram:
            found = unconnected(block, diagram.GetSubsystemContext(block, context))
            if found:
                return found
    return ""


def _is_of_hold(port: str) -> bool:
    return port == SAMPLE_TIME or port.startswith(HELD)


def connections(diagram: Diagram) -> list[str]:
    """The wires "block.port -> block.port" that a built diagram really has."""
    return [
        f"{source.get_name()}.{source.get_output_port(k).get_name()} -> "
        f"{target.get_name()}.{target.get_input_port(i).get_name()}"
        for (target, i), (source, k) in diagram.connection_map().items()
    ]
