"""The paper's problem in twenty lines, as an optimization layer, beside the shipped layers.

`NlpLayer` gives a cost and constraints of [ξ, A] to one of Drake's solvers at each update. Here
they are the paper's: the least change of ξ, A and the internal force (eq. 26) that keeps the
carriers' speeds above ε (eq. 24), but at 16 phases of the orbit instead of the present one. From
this folder the layer also goes by its import path:

    drake-nonstop run quintic_nlp --trust --set optimization_layer=your_own_program.PaperProblem
"""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from drake_nonstop import (
    NlpLayer,
    NlpLayerConfig,
    carrier_speeds,
    compute_metrics,
    load_scenario,
    simulate,
)
from drake_nonstop.mechanics.internal_force import internal_force

PHASES = 2 * np.pi * np.arange(16) / 16


@dataclass(kw_only=True)
class PaperProblemConfig(NlpLayerConfig):
    """The fields of `NlpLayer`, of which a swap keeps the values."""


class PaperProblem(NlpLayer):
    """Changes ξ, A and the internal force as little as keeps the speeds above ε."""

    def cost(self, x: NDArray, now: SimpleNamespace) -> NDArray:
        """J of eq. 26, without the units of its terms."""
        theta, phases = now.phase[:1], self.model.pattern.phases
        after = internal_force(x, theta, phases=phases)
        before = internal_force(now.previous, theta, phases=phases)
        changes = np.concatenate([x - now.previous, after[0] - before[0], after[1] - before[1]])
        return changes @ changes

    def constraints(self, x: NDArray, now: SimpleNamespace) -> NDArray:
        """Speeds (16, n) above ε, m/s: eq. 24 along the orbit."""
        load = now.reference, now.wrench, now.wrench_rate
        speeds = carrier_speeds(self.model, *load, x[0], x[1], now.phase[:1] + PHASES)
        return speeds - (1 + self.config.tightening) * now.speed_bound


LAYERS = {
    "RecedingHorizonOptimizer": ("quintic", {}),
    "PaperLayer": ("quintic", {"optimization_layer": "PaperLayer"}),
    "NlpLayer": ("quintic_nlp", {}),
    "PaperProblem": ("quintic_nlp", {}),
}


def main(duration: float = 11.0) -> None:
    """Compares the layers on the quintic task."""
    print("layer, slowest carrier - bound, largest load error, update (median, p99), solved of")
    for name, (scenario_name, changes) in LAYERS.items():
        changes = changes | {"simulation_duration": duration}
        scenario = load_scenario(scenario_name, [f"{k}={v}" for k, v in changes.items()])
        own = {"optimization_layer": PaperProblem} if name == "PaperProblem" else {}
        metrics = compute_metrics(simulate(scenario, **own))
        carriers, layer = metrics["carriers"], metrics["optimizer"]
        margin = carriers["speed_min_m_s"] - scenario.speed_bound
        times, error = layer["solve_time_ms"], 1e6 * metrics["load"]["position_error_max_m"]
        print(
            f"{name:26} {margin:+.3f} m/s, load error {error:.1f} µm, "
            f"{times['p50']:.1f} / {times['p99']:.1f} ms, {layer['solved']} of {layer['updates']}"
        )


if __name__ == "__main__":
    main()
