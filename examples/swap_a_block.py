"""Put a block of your own in the figure: a force on the load, which the controllers ignore."""

from dataclasses import dataclass

import numpy as np

from drake_nonstop import Block, compute_metrics, load_scenario, simulate


@dataclass(kw_only=True)
class GustConfig:
    """How strong the gust is."""

    share: float = 0.05  # of the load's weight, at the peak


class Gust(Block):
    """A sideways force on the load that swells and fades.

    The output port carries the name of the signal that it makes, and so is connected to
    whatever reads that signal; an input port would be connected in the same way.
    """

    makes = ("disturbance_wrench",)
    reads_time = True
    system = ("load_mass", "gravity")

    @staticmethod
    def equations(time, *, share, load_mass, gravity):
        """The wrench (6,), torque and force."""
        sideways = share * load_mass * gravity * np.sin(np.pi * time / 5) ** 2
        return np.concatenate([np.zeros(4), sideways, np.zeros(1)])


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
