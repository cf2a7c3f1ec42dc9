"""A custom optimization layer in a file of its own, and how to compare it with the others.

The block reads and makes signals by their names; that is all there is to the contract, which
`drake-nonstop blocks optimization_layer` prints. A scenario, or an ablation, names it by its
import path, which is its YAML tag: from this folder,

    drake-nonstop ablate quintic --trust --swap optimization_layer=write_your_own_optimizer.Hurry
"""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from drake_nonstop import Model, compute_metrics, load_scenario, simulate


@dataclass(kw_only=True)
class HurryConfig:
    """Fields that `NonstopOptimizer` has too: a swap keeps their values."""

    speed_bound: float = 0.2  # m/s
    frequency: float = 2.0  # rad/s, at the start
    amplitude: float = 1.2  # N
    period: float = 0.01  # s


class Hurry(LeafSystem):
    """No optimization at all: turns the faster the faster the load is to move."""

    def __init__(self, model: Model, config: HurryConfig):
        super().__init__()
        self._config = config
        share = model.load_mass * model.gravity / model.n
        self._radius = model.cable_length * config.amplitude / np.hypot(config.amplitude, share)
        self._reference = self.DeclareVectorInputPort("reference", 22)
        index = self.DeclareDiscreteState([config.frequency, config.amplitude])
        self.DeclareStateOutputPort("parameters", index)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, config.period, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        load_speed = np.linalg.norm(self._reference.Eval(context)[10:13])
        needed = (self._config.speed_bound + load_speed) / self._radius
        state.set_value([max(needed, self._config.frequency), self._config.amplitude])


def main(duration: float = 15.0) -> None:
    """Compares the two on the quintic task."""
    scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
    own = HurryConfig(speed_bound=scenario.optimization_layer.speed_bound)
    for name, layer in (("optimized", scenario.optimization_layer), ("in a hurry", own)):
        metrics = compute_metrics(simulate(scenario, optimization_layer=layer))
        carriers, load = metrics["carriers"], metrics["load"]
        print(
            f"{name:10} {carriers['speed_min_m_s']:.3f} to {carriers['speed_max_m_s']:.3f} m/s, "
            f"{carriers['time_below_bound_s']:.2f} s below the bound, "
            f"mean load error {1e3 * load['position_error_mean_m']:.2f} mm"
        )


if __name__ == "__main__":
    main()
