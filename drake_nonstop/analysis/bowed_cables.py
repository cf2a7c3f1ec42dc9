"""What straight cables leave out of a flight: how far drag bows them, and what they weigh."""

import math
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft

_DENSITY = 970.0  # kg/m³, of Dyneema
_LEAST_TENSION = 1e-3  # N, of a cable that is all but slack
_SHARE_OF_WIDTH = 0.01  # by which two cables may differ in length


class BowedCables(NamedTuple):
    """How drag would bow the cables of aircraft, which are simulated as straight.

    The figures are those of a still load: the air moves past a cable as fast as its aircraft at its
    upper end, and not at the lower one. So the drag on its length, w_d = ½ ρ C_D d V² at the upper
    end, grows with the square of the place: of a tension T and a length L the cable bows farthest
    by w_d L²/(16 ∛4 T), at 0.63 of L, and its chord is shorter by 9/14 L (w_d L/(12 T))². Own
    derivation, for small bows.
    """

    bow: float  # m, the largest
    shortening: tuple[float, float]  # m, of a chord, the least and the largest
    difference: float  # m, of the shortenings of two cables at one instant, the largest
    mass: float  # kg, of a cable
    load_width: float  # m, the largest distance of two attachments

    @classmethod
    def of(
        cls, aircraft: Aircraft, airspeeds: NDArray, tensions: NDArray, attachments: NDArray
    ) -> "BowedCables":
        """Those of n aircraft at airspeeds (k, n), m/s, and tensions (k, n), N.

        Args:
            aircraft: its cable_diameter, cable_drag, cable_length and air_density count.
            airspeeds: m/s.
            tensions: N.
            attachments: (n, 3), m.
        """
        taut = np.maximum(tensions, _LEAST_TENSION)
        size = aircraft.air_density / 2 * aircraft.cable_drag * aircraft.cable_diameter
        drag, length = size * airspeeds**2, aircraft.cable_length
        sag = drag * length / taut
        shorter = 9 / 14 * length * (sag / 12) ** 2
        return cls(
            bow=float(np.max(sag) * length) / (16 * 4 ** (1 / 3)),
            shortening=(float(np.min(shorter)), float(np.max(shorter))),
            difference=float(np.max(np.ptp(shorter, axis=1))),
            mass=float(_DENSITY * math.pi / 4 * aircraft.cable_diameter**2 * length),
            load_width=max(float(np.linalg.norm(a - b)) for a, b in combinations(attachments, 2)),
        )

    @property
    def text(self) -> str:
        """All of it in a line."""
        least, most = self.shortening
        return (
            f"bow by up to {self.bow:.2g} m and are {least:.2g} to {most:.2g} m shorter, "
            f"two of them by up to {self.difference:.2g} m differently; {self.mass:.2g} kg each"
        )

    @property
    def warning(self) -> str:
        """What to expect of a real flight; "" where the cables stay alike."""
        allowed = _SHARE_OF_WIDTH * self.load_width
        if self.difference <= allowed:
            return ""
        return (
            f"cables are simulated as straight: drag would shorten two of them by up to "
            f"{self.difference:.2g} m differently, more than a hundredth of the load's width "
            f"({allowed:.2g} m), which turns and moves the load; give thinner cables "
            "(aircraft.cable_diameter) or more tension, or expect a flight that differs"
        )

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file."""
        return {
            "bow_m": self.bow,
            "shortening_m": list(self.shortening),
            "shortening_difference_m": self.difference,
            "mass_kg": self.mass,
            "load_width_m": self.load_width,
            "warning": self.warning,
        }
