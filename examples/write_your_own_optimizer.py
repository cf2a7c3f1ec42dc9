"""A custom optimization layer in a file of its own, and how to compare it with the others.

The block reads and makes signals by their names; that is all there is to the contract, which
`drake-nonstop blocks optimization_layer` prints. A scenario, or an ablation, names it by its import
path, which is its YAML tag: from this folder,

    drake-nonstop ablate quintic --trust --swap optimization_layer=write_your_own_optimizer.Hurry
"""

from dataclasses import dataclass

import numpy as np

from drake_nonstop import Block, compute_metrics, load_scenario, simulate
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.systems.tracing import where


@dataclass(kw_only=True)
class HurryConfig:
    """Fields that `PaperLayer` has too: a swap keeps their values."""

    speed_bound: float = 0.2  # m/s
    frequency: float = 2.0  # rad/s, at least
    amplitude: float = 1.2  # N


class Hurry(Block):
    """No optimization at all: turns the faster the faster the load is to move."""

    reads = ("reference",)
    makes = ("parameters",)
    system = ("load_mass", "gravity", "cable_length")
    of_model = ("n",)

    @staticmethod
    def equations(
        reference, *, speed_bound, frequency, amplitude, load_mass, gravity, n, cable_length
    ):
        """Frequency and amplitude (2,)."""
        share = load_mass * gravity / n
        radius = cable_length * amplitude / np.sqrt(amplitude**2 + share**2)
        needed = (speed_bound + norm(LoadReference.view(reference).velocity)) / radius
        return np.concatenate([where(needed[0] > frequency[0], needed, frequency), amplitude])


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
