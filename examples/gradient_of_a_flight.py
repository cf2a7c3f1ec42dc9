"""The gradient of a flight: how the error that it ends with changes with every number of its loop.

The compiled loop is flown once, with derivatives by all parameters of its blocks; central
differences would need two flights for each of them. Searches of an optimization layer have none:
ConstantParameters takes its place.
"""

import numpy as np

from drake_nonstop import CompiledLoop, load_scenario, make_nonstop, with_largest_step


def main(duration: float = 2.0) -> None:
    """Flies the first seconds of the quintic task."""
    scenario = load_scenario("quintic", ["optimization_layer=ConstantParameters"])
    diagram = make_nonstop(scenario)
    start = diagram.CreateDefaultContext()
    config = with_largest_step(scenario.simulator_config, diagram, start)
    loop = CompiledLoop(diagram, config, scenario.control_period, compiles=None)
    values, names = loop.parameters_of(start), loop.parameter_names
    found = loop.sensitivities(start, duration)

    load, reference = (found.signals[name][-1, 4:7] for name in ("load_state", "reference"))
    slopes = 2 * (load - reference) @ found.signals_by_parameters["load_state"][-1, 4:7]
    squared_error = (load - reference) @ (load - reference)
    print(f"final load error  {1e3 * np.sqrt(squared_error):.3f} mm")
    percents = 0.5 * slopes * values / squared_error
    heights = found.signals_by_parameters["load_state"][-1, 6]
    for percent, name in zip(percents, names, strict=True):
        if name.startswith(("wrench_controller", "carrier_controller")) and "gain" in name:
            print(f"{percent:+8.4f} %  for 1 % more {name}")
    believed = [name.endswith(".load_mass") and not name.startswith("load_plant") for name in names]
    height = 10 * heights[believed].sum()  # mm for 1 % of 1 kg
    print(f"{height:+8.4f} mm of height for 1 % more system.load_mass, in all that believe it")


if __name__ == "__main__":
    main()
