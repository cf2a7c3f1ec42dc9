"""Named blocks to a Diagram: wires follow from the names of the ports."""

from collections.abc import Mapping

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System

from drake_nonstop.validation import ScenarioError


class WiringError(ScenarioError):
    """The blocks do not make a complete diagram."""


def output_names(block: System) -> list[str]:
    """The names of the block's output ports, in order."""
    return [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]


def input_names(block: System) -> list[str]:
    """The names of the block's input ports, in order."""
    return [block.get_input_port(i).get_name() for i in range(block.num_input_ports())]


def wires(
    blocks: Mapping[str, System], replaced_signals: Mapping[str, str] | None = None
) -> list[str]:
    """The wires "block.port -> block.port" that the names of the ports imply.

    Every output port is a signal with a name of its own, and an input port named after a
    signal is connected to it. `replaced_signals` maps a signal to the one that readers
    get in its place, save those that make a signal or its replacement: what is upstream
    of a replacement must not read it.

    Raises:
        WiringError: two blocks make the same signal, or an input names none.
    """
    sources: dict[str, str] = {}
    for block_name, block in blocks.items():
        for signal in output_names(block):
            if signal in sources:
                raise WiringError(
                    f"{block_name}.{signal} = output: {sources[signal]} has an output port of "
                    "that name already; rename one of the two"
                )
            sources[signal] = block_name
    result = []
    replaced_signals = replaced_signals or {}
    upstream = {sources.get(signal) for signal in (*replaced_signals, *replaced_signals.values())}
    for block_name, block in blocks.items():
        for port in input_names(block):
            signal = port if block_name in upstream else replaced_signals.get(port, port)
            if signal not in sources:
                raise WiringError(
                    f"{block_name}.{port} = input: no block has an output port of that name; "
                    f"name the port after one of {', '.join(sorted(sources))}"
                )
            result.append(f"{sources[signal]}.{signal} -> {block_name}.{port}")
    return result


def connect(
    blocks: Mapping[str, System],
    *,
    name: str,
    replaced_signals: Mapping[str, str] | None = None,
) -> Diagram:
    """Wires the blocks (see `wires`) to a diagram that exports every signal by its name.

    The blocks become subsystems named after their keys.

    Raises:
        WiringError: as `wires`, or the sizes of two connected ports differ.
    """
    builder = DiagramBuilder()
    for block_name, block in blocks.items():
        block.set_name(block_name)
        builder.AddSystem(block)
    for wire in wires(blocks, replaced_signals):
        source, target = (end.split(".") for end in wire.split(" -> "))
        output = blocks[source[0]].GetOutputPort(source[1])
        target_port = blocks[target[0]].GetInputPort(target[1])
        if output.size() != target_port.size():
            raise WiringError(
                f"{target[0]}.{target[1]} = input of size {target_port.size()}: "
                f"{source[0]}.{source[1]} has size {output.size()}; give the port that size"
            )
        builder.Connect(output, target_port)
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
