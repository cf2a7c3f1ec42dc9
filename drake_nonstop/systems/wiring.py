"""Builds a Diagram from named blocks: wires follow from the names of the ports."""

from collections.abc import Collection, Mapping

from pydrake.systems.framework import (
    Diagram,
    DiagramBuilder,
    InputPort,
    OutputPort,
    PortDataType,
    System,
)

from drake_nonstop.validation import ScenarioError

OUTSIDE = "outside"  # what wires call the diagram's own input ports

Sizes = Mapping[str, int | None]  # of ports or signals, by name; None: abstract-valued


class WiringError(ScenarioError):
    """The blocks do not make a complete diagram."""


def output_names(block: System) -> list[str]:
    """The names of the block's output ports, in order."""
    return list(output_sizes(block))


def input_names(block: System) -> list[str]:
    """The names of the block's input ports, in order."""
    return list(input_sizes(block))


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


def check_outputs(name: str, block: System, required: Sizes, optional: Sizes) -> None:
    """Checks the outputs of the block that goes by that name; it may have others besides.

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


def _listed(sizes: Sizes) -> str:
    """The ports or signals as "force (3), pose (7)"."""
    named = [f"{name} ({'abstract' if size is None else size})" for name, size in sizes.items()]
    return ", ".join(named) or "none"


def _expected(wrong: Sizes, signals: Sizes) -> str:
    """What input ports would have to be that no signal can be connected to."""
    expected = {name: signals[name] for name in wrong if name in signals}
    unknown = {name: size for name, size in wrong.items() if name not in signals}
    parts = [f"expected {_listed(expected)}"] if expected else []
    if unknown:
        parts.append(
            f"{_listed(unknown)} {'is' if len(unknown) == 1 else 'are'} not among the signals "
            f"{_listed(dict(sorted(signals.items())))}"
        )
    return " and ".join(parts)


def wires(
    blocks: Mapping[str, System],
    replaced_signals: Mapping[str, str] | None = None,
    outside: Sizes | None = None,
    optional_inputs: Collection[str] = (),
) -> list[str]:
    """The wires "block.port -> block.port" that the names of the ports imply.

    Every output port is a signal with a name of its own, and an input port named after a
    signal is connected to it. `replaced_signals` maps a signal to the one that readers
    get in its place, save those that make a signal or its replacement: what is upstream
    of a replacement must not read it. `outside` are signals that no block makes: their wires
    come from "outside.port". The ports "block.port" of `optional_inputs` have no wire where
    there is no signal of their name.

    Raises:
        WiringError: two blocks make the same signal, a replacement is made by none, or an
            input names no signal, or one of another size.
    """
    outside = outside or {}
    sources: dict[str, str] = dict.fromkeys(outside, OUTSIDE)
    sizes: dict[str, int | None] = dict(outside)
    for block_name, block in blocks.items():
        for signal, size in output_sizes(block).items():
            if signal in sources:
                raise WiringError(
                    f"{block_name}.{signal} = output: {sources[signal]} has an output port of "
                    "that name already; rename one of the two"
                )
            sources[signal], sizes[signal] = block_name, size
    result = []
    replaced_signals = replaced_signals or {}
    for signal, replacement in replaced_signals.items():
        if replacement not in sources:
            raise WiringError(
                f"replacement of {signal} = {replacement}: no block has an output port of that "
                f"name; give one of {', '.join(sorted(sources))}"
            )
    upstream = {sources.get(signal) for signal in (*replaced_signals, *replaced_signals.values())}
    for block_name, block in blocks.items():
        given = input_sizes(block)
        replaced = {} if block_name in upstream else replaced_signals
        read = {
            port: replaced.get(port, port)
            for port in given
            if port in sources or f"{block_name}.{port}" not in optional_inputs
        }
        wrong = {
            port: given[port]
            for port, signal in read.items()
            if signal not in sources or sizes[signal] != given[port]
        }
        if wrong:
            raise WiringError(
                f"{block_name} = {type(block).__name__} with inputs {_listed(given)}: "
                f"{_expected(wrong, sizes)}; rename or resize the ports"
            )
        result += [
            f"{sources[signal]}.{signal} -> {block_name}.{port}" for port, signal in read.items()
        ]
    return result


def connect(
    blocks: Mapping[str, System],
    *,
    name: str,
    replaced_signals: Mapping[str, str] | None = None,
    outside: Sizes | None = None,
    optional_inputs: Collection[str] = (),
) -> Diagram:
    """Wires the blocks (see `wires`) to a diagram that exports every signal by its name.

    The blocks become subsystems named after their keys, and the signals that come from
    `outside` input ports of the diagram.

    Raises:
        WiringError: as `wires`.
    """
    builder = DiagramBuilder()
    for block_name, block in blocks.items():
        block.set_name(block_name)
        builder.AddSystem(block)
    exported = set()
    for wire in wires(blocks, replaced_signals, outside, optional_inputs):
        (source, signal), target = (end.split(".") for end in wire.split(" -> "))
        port = blocks[target[0]].GetInputPort(target[1])
        if source != OUTSIDE:
            builder.Connect(blocks[source].GetOutputPort(signal), port)
        elif signal in exported:
            builder.ConnectInput(signal, port)
        else:
            builder.ExportInput(port, signal)
            exported.add(signal)
    for block in blocks.values():
        for signal in output_names(block):
            builder.ExportOutput(block.GetOutputPort(signal), signal)
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


def connections(diagram: Diagram) -> list[str]:
    """The wires "block.port -> block.port" that a built diagram really has."""
    result = []
    for (target, target_index), (source, source_index) in diagram.connection_map().items():
        output: OutputPort = source.get_output_port(source_index)
        result.append(
            f"{source.get_name()}.{output.get_name()} -> "
            f"{target.get_name()}.{target.get_input_port(target_index).get_name()}"
        )
    return result
