"""Builds a Diagram from named blocks: wires follow from the names of the ports."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import NamedTuple

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
from pydrake.systems.primitives import PassThrough

from drake_nonstop.mechanics.signals import HELD
from drake_nonstop.systems.block import box_of
from drake_nonstop.systems.documentation import declared_by
from drake_nonstop.validation import listed, require

INPUT = "input"  # ends the names of what passes an input of the diagram on, as an output of it
INPUTS = "inputs"  # the maker, in a wire, of signals that come from outside of the diagram

Sizes = Mapping[str, int | None]  # of ports or signals, by name; None: abstract-valued


class Wire(NamedTuple):
    """A connection of a block's output, or of an input of the diagram, to a block's input."""

    maker: str
    signal: str
    reader: str
    port: str


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
    found = set(declared_by(block, "optional_inputs", ()))
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
    return _sizes(map(block.get_output_port, range(block.num_output_ports())))


def input_sizes(block: System) -> Sizes:
    """The sizes of the block's input ports, in order."""
    return _sizes(map(block.get_input_port, range(block.num_input_ports())))


def passes_on(block: System, signal: str) -> bool:
    """Whether a diagram shows a signal that it is given, as an output of the input's name."""
    has_both = block.HasInputPort(signal) and block.HasOutputPort(signal)
    return isinstance(block, Diagram) and has_both


def _sizes(ports: Iterable[InputPort | OutputPort]) -> Sizes:
    vector = PortDataType.kVectorValued
    return {p.get_name(): p.size() if p.get_data_type() == vector else None for p in ports}


def _sized(name: str, size: int | None) -> str:
    """The port or signal as "force (3)"."""
    return f"{name} ({'abstract' if size is None else size})"


def wires(
    blocks: Mapping[str, System],
    inputs: Collection[str] = (),
    *,
    takes: Callable[[Wire], bool] | None = None,
) -> list[Wire]:
    """The wires that the names of the ports imply, see `connect_by_name`.

    Ports named in the attribute `optional_inputs` of a block have no wire where there is no such
    signal.

    Args:
        blocks: by their names.
        inputs: signals from outside, as of `connect_by_name`.
        takes: which of the wires are asked for, where inputs may stay open; None: all.

    Raises:
        ScenarioError: two blocks make the same signal, or an input names no signal, or one of
            another size, or an entry of `inputs` is made by a block, or read by none.
    """
    sizes = sizes_of_inputs(blocks, inputs)
    makers = {signal: [INPUTS] for signal in sizes}
    called = {name: type(b).__name__ if "@" in name else name for name, b in blocks.items()}
    called[INPUTS] = INPUTS
    passed: dict[str, list[str]] = {}
    for name, block in blocks.items():
        for signal, size in output_sizes(block).items():
            to = passed if passes_on(block, signal) else makers
            to.setdefault(signal, []).append(name)
            sizes.setdefault(signal, size)
    makers = passed | makers

    def require_one_maker(signal: str) -> None:
        first, *_ = names = [called[name] for name in makers[signal]]
        remedy = "rename one of the two, leave one of them out, or connect by hand what reads it"
        said = f"{first} has a port of that name already; {remedy}"
        require(len(names) == 1, f"{names[-1]}.{signal}", "output", said)

    for signal in makers if takes is None else ():
        require_one_maker(signal)
    known = ", ".join(_sized(*pair) for pair in sorted(sizes.items()))
    result = []
    for name, read in _signals_read(blocks, makers).items():
        for port, signal in read.items():
            others = [maker for maker in makers.get(signal, ()) if maker != name]
            found = [Wire(maker, signal, name, port) for maker in others]
            if takes is not None and not any(map(takes, found)):
                continue
            size = input_sizes(blocks[name])[port]
            field = called[name]
            value = f"{type(blocks[name]).__name__} with input {_sized(port, size)}"
            remedy = f"rename the port, or give make_nonstop or connect_by_name inputs={[port]}"
            require(found, field, value, f"it is not among the signals {known}; {remedy}")
            require_one_maker(signal)
            other = f"{called[found[0].maker]} makes {_sized(signal, sizes[signal])}"
            remedy = "rename or resize one of the ports"
            require(size == sizes[signal], field, value, f"{other}; {remedy}")
            result += found
    return result


def _signals_read(blocks: Mapping[str, System], made: Collection[str]) -> dict[str, dict[str, str]]:
    """The signal that each input port is named after, or what is held of it, by names of blocks.

    An optional input of no signal is left out.
    """
    held = {
        port: f"{HELD}{port}"
        for block in blocks.values()
        for port in declared_by(block, "replaces") or input_names(block)
        if block.HasOutputPort(f"{HELD}{port}")
    }
    upstream = {*held, *held.values()}
    result = {}
    for name, block in blocks.items():
        made_by_it = {name for name in output_names(block) if not passes_on(block, name)}
        replaced = {} if upstream & made_by_it else held
        optional = optional_inputs(block)
        result[name] = {
            port: replaced.get(port, port)
            for port in input_names(block)
            if port in made or port not in optional
        }
    return result


def connect_remaining(builder: DiagramBuilder, *, of: System | None = None) -> None:
    """Connects the open inputs to the signals of their names, as `connect_by_name` does.

    The builder has all blocks, named or not, some of them connected by hand. An input stays open
    where no block of the builder makes its signal: it can be exported, or connected, before or
    after. Unless the builder has exports, each signal that one block alone makes is exported by its
    name, as `simulate` and logs need it; outputs of Drake's own leaf systems are no signals.

    With `of`, one of its systems, only what leads to it or comes from it is connected, and nothing
    is exported.

    Raises:
        ScenarioError: the builder is built, two blocks make the signal of an open input, or its
            size is another one.
    """
    require_open(builder, "connect_remaining")
    blocks = {block.get_name(): block for block in builder.GetMutableSystems()}

    def takes(wire: Wire) -> bool:
        is_asked = of is None or of in (blocks[wire.maker], blocks[wire.reader])
        port = blocks[wire.reader].GetInputPort(wire.port)
        return is_asked and not builder.IsConnectedOrExported(port)

    _connect(builder, blocks, wires(blocks, takes=takes))
    if of is None and builder.num_output_ports() == 0:
        drakes = {b for b in blocks.values() if type(b).__module__.startswith("pydrake")}
        _export(builder, [b for b in blocks.values() if b not in drakes or isinstance(b, Diagram)])


def _connect(builder: DiagramBuilder, blocks: Mapping[str, System], planned: list[Wire]) -> None:
    """Makes the wires, and inputs of the diagram where they come from outside."""
    exported: set[str] = set()
    for wire in planned:
        port = blocks[wire.reader].GetInputPort(wire.port)
        if wire.maker != INPUTS:
            builder.Connect(blocks[wire.maker].GetOutputPort(wire.signal), port)
        elif wire.signal in exported:
            builder.ConnectInput(wire.signal, port)
        else:
            builder.ExportInput(port, wire.signal)
            exported.add(wire.signal)


def sizes_of_inputs(blocks: Mapping[str, System], inputs: Collection[str]) -> dict[str, int | None]:
    """The sizes of signals from outside, as the first reader of each has them."""
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
    inputs: Collection[str] = (),
) -> None:
    """Adds blocks to a builder, wires them by the names of their ports, exports every signal.

    Each output port is a signal with a name of its own; an input port named after a signal is
    connected to it, and the diagram has an output port of that name, also of those that come from
    outside. Where a block makes `held_x`
    of an input x, as `SampleAndHold` does, readers of x get `held_x` in its place; blocks that make
    x, or anything that is held, do not: what is upstream of a hold must not read from it.
    `make_nonstop` wires the figure in this way.

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
        is_name = isinstance(name, str) and name and not {":", "."} & set(name)
        require(is_name, "blocks", name, "name each block by a text without colons and dots")
        remedy = "give a LeafSystem or Diagram"
        require(isinstance(block, System), f"blocks.{name}", block, remedy)
        is_new = not builder.HasSubsystemNamed(name)
        require(is_new, "blocks", name, "the builder has a system of that name; give another one")
    planned = wires(blocks, inputs)
    for block_name, block in blocks.items():
        block.set_name(block_name)
        builder.AddSystem(block)
    _connect(builder, blocks, planned)
    for signal, size in sizes_of_inputs(blocks, inputs).items():
        readers = [block for block in blocks.values() if block.HasInputPort(signal)]
        if size is not None and any(signal not in optional_inputs(block) for block in readers):
            passing = builder.AddNamedSystem(f"{signal}_{INPUT}", PassThrough(size))
            builder.ConnectInput(signal, passing.get_input_port())
            builder.ExportOutput(passing.get_output_port(), signal)
    _export(builder, blocks.values())


def _export(builder: DiagramBuilder, blocks: Collection[System]) -> None:
    """Exports each signal that one of the blocks alone makes."""
    # Drake's FirstOrderTaylorApproximation takes the first output, and crashes where that depends
    # on no state, as the signals of a block without inputs.
    ordered = sorted(blocks, key=lambda block: block.num_input_ports() == 0)
    made = [(b, name) for b in ordered for name in output_names(b) if not passes_on(b, name)]
    counts = Counter(name for _, name in made)
    for block, name in made:
        if counts[name] == 1:
            builder.ExportOutput(block.GetOutputPort(name), name)


def require_open(builder: DiagramBuilder, function: str) -> None:
    """Raises ScenarioError for what is no DiagramBuilder, or built before the function's call."""
    require(isinstance(builder, DiagramBuilder), "builder", builder, "give a DiagramBuilder")
    remedy = f"call {function} before builder.Build()"
    require(not builder.already_built(), "builder", "built", remedy)


# Diagrams that are built


def connections(diagram: Diagram) -> list[str]:
    """The wires "block.port -> block.port" that a built diagram has."""
    return [
        f"{source.get_name()}.{source.get_output_port(k).get_name()} -> "
        f"{target.get_name()}.{target.get_input_port(i).get_name()}"
        for (target, i), (source, k) in diagram.connection_map().items()
    ]


def systems_in(system: System) -> Iterator[System]:
    """A system, and all systems inside of it, each followed by what is in it."""
    yield system
    for part in system.GetSystems() if isinstance(system, Diagram) else ():
        yield from systems_in(part)


def source_of(exported: OutputPort) -> OutputPort:
    """The port of a diagram's own subsystem that it exports."""
    maker, index = exported.get_system().get_output_port_locator(exported.get_index())
    return maker.get_output_port(index)


def ports_of(diagram: Diagram, signal: str) -> list[OutputPort]:
    """The ports that show a signal: that which the diagram exports by this name, or else all.

    Those of its subsystems, and in diagrams without such a port those of theirs. Where there are
    none, and of a part that takes the signal as an input, the port that is connected to the input.
    """
    made, found = {}, []
    for (reader, index), (maker, k) in diagram.connection_map().items():
        if reader.get_input_port(index).get_name() == signal:
            made[reader.get_name()] = maker.get_output_port(k)
    if diagram.HasOutputPort(signal):
        found = [source_of(diagram.GetOutputPort(signal))]
    else:
        for part in diagram.GetSystems():
            if part.HasOutputPort(signal):
                found.append(part.GetOutputPort(signal))
            elif isinstance(part, Diagram):
                found += ports_of(part, signal)
    if not found:
        return [*{(p.get_system().get_name(), p.get_index()): p for p in made.values()}.values()]
    passing = {p.get_system().get_name() for p in found if passes_on(p.get_system(), signal)}
    return [made.get(n, p) if (n := p.get_system().get_name()) in passing else p for p in found]


def loop_in(diagram: Diagram, signals: Collection[str]) -> Diagram:
    """The innermost diagram, in one or that itself, that all ports of these signals are in."""
    makers = {port.get_system() for signal in signals for port in ports_of(diagram, signal)}
    for part in diagram.GetSystems():
        is_around = isinstance(part, Diagram) and makers <= {*systems_in(part)}
        if is_around and all(ports_of(part, signal) for signal in signals):
            return loop_in(part, signals)
    return diagram


def context_in(diagram: Diagram, part: System, context: Context) -> Context:
    """The context of a part of a diagram, or the diagram's, which Drake would never free."""
    return context if part is diagram else diagram.GetMutableSubsystemContext(part, context)


def require_signals(
    diagram: Diagram, sizes: Sizes, field: str, *, is_exporting: bool = True
) -> None:
    """Checks that a diagram makes signals, each in one place, and exports them if it has to.

    If it does not have to, none of them may be an input of it.

    `sizes` are those of the ports, None for any, and `field` is what the error calls the diagram.

    Raises:
        ScenarioError: it lacks some, they have other sizes, two blocks make one, or it is an input.
    """
    found = {signal: ports_of(diagram, signal) for signal in sizes}
    wrong = [
        signal
        for signal, size in sizes.items()
        if not found[signal]
        or size not in (None, found[signal][0].size())
        or (is_exporting and not diagram.HasOutputPort(signal))
    ]
    pairs = sizes.items()
    needed = ", ".join(name if size is None else f"{name} ({size})" for name, size in pairs)
    lacking = f"{type(diagram).__name__} without output ports {', '.join(wrong)}"
    remedy = f"give it blocks that make {needed}, and export these by their names, as "
    require(not wrong, field, lacking, f"{remedy}connect_by_name and connect_remaining do")
    remedy = "give the diagram around it in which a system makes this signal, with its context"
    for name in sizes:
        is_input = not is_exporting and diagram.HasInputPort(name)
        require(not is_input, field, f"{type(diagram).__name__} with the input {name}", remedy)
    for name, ports in found.items():
        makers = " and ".join(box_of(port.get_system()) for port in ports)
        remedy = "rename the port of the other, or give the diagram with one of them"
        twice = f"{type(diagram).__name__} where {makers} make {name}"
        require(len(ports) == 1, field, twice, f"export the loop's by this name, {remedy}")


def require_context(field: str, system: System, context: Context) -> None:
    """Raises ScenarioError unless the context, of that name in errors, is that of the system.

    Drake's own functions end the process where they copy states of other sizes.
    """
    is_own = isinstance(system, System)  # of floats
    try:
        system.ValidateContext(context)
    except (RuntimeError, TypeError):
        is_own = False
    value = f"{type(context).__name__} of another system than this {type(system).__name__}"
    remedy = (
        "give that of a diagram of floats, such as diagram.CreateDefaultContext(), and "
        "diagram.GetMyMutableContextFromRoot(root) inside of a bigger one"
    )
    require(is_own, field, value, remedy)
