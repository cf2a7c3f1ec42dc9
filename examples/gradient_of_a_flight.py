"""The gradient of a flight: how the error that it ends with changes with every gain.

The loop is converted to Drake's AutoDiffXd and flown once, with derivatives by all gains; central
differences would need two flights for each of them. The optimization layer computes with
floating-point numbers only: ConstantParameters takes its place.
"""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator_

from drake_nonstop import (
    load_scenario,
    make_nonstop,
    parameters,
    set_equilibrium,
    set_parameter,
)


def main(duration: float = 2.0) -> None:
    """Flies the first seconds of the quintic task, of which each takes some four seconds."""
    scenario = load_scenario("quintic", ["optimization_layer=ConstantParameters"])
    loop = make_nonstop(scenario)
    start = loop.CreateDefaultContext()
    set_equilibrium(loop, start)
    boxes = ("wrench_controller", "carrier_controller")
    gains = {
        entry.path: float(entry.value)
        for entry in parameters(loop, start)
        if entry.path.startswith(boxes) and entry.value != 0
    }

    converted = loop.ToAutoDiffXd()
    simulator = Simulator_[AutoDiffXd](converted)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    context = simulator.get_mutable_context()
    context.SetTimeStateAndParametersFrom(start)
    for i, (path, gain) in enumerate(gains.items()):
        set_parameter(loop, context, path, AutoDiffXd(gain, len(gains), i))
    simulator.AdvanceTo(duration)

    load, reference = (
        converted.GetOutputPort(name).Eval(context)[4:7] for name in ("load_state", "reference")
    )
    squared_error = (load - reference) @ (load - reference)
    print(f"final load error  {1e3 * np.sqrt(squared_error.value()):.3f} mm")
    for (path, gain), slope in zip(gains.items(), squared_error.derivatives(), strict=True):
        percent = 0.5 * slope * gain / squared_error.value()
        print(f"{percent:+8.4f} %  for 1 % more {path}")


if __name__ == "__main__":
    main()
