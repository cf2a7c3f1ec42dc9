"""Put a block of your own in the figure: a force on the load, which the controllers ignore."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_nonstop import Model, compute_metrics, load_scenario, simulate


class Gust(LeafSystem):
    """A sideways force on the load that swells and fades.

    The output port carries the name of the signal that it makes, and so is connected to
    whatever reads that signal; an input port would be connected in the same way.
    """

    def __init__(self, model: Model):
        super().__init__()
        self._peak = 0.05 * model.load_mass * model.gravity  # N
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        force = self._peak * np.sin(np.pi * context.get_time() / 5) ** 2
        output.SetFromVector([0, 0, 0, 0, force, 0])


def main(duration: float = 15.0) -> None:
    """Compares the quintic task in still air and in a gust."""
    scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
    for name, replacements in (("still air", {}), ("gust", {"load_disturbance": Gust})):
        metrics = compute_metrics(simulate(scenario, **replacements))
        print(
            f"{name:10} mean load error {1e3 * metrics['load']['position_error_mean_m']:7.2f} mm, "
            f"slowest carrier {metrics['carriers']['speed_min_m_s']:.3f} m/s"
        )


if __name__ == "__main__":
    main()
