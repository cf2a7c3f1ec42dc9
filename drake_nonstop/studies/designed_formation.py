"""A designed formation, why there is none, and the scenario that flies one."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_nonstop.analysis.flight_envelope import BowedCables
from drake_nonstop.optimization.formation_program import LEANING, FormationVariables
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import as_override
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design_request import GRAVITY, DesignRequest
from drake_nonstop.studies.formation_flight import PEAK, Break, FlightExtremes

_START_TIME, _END_TIME, _REST_TIME = 5.0, 10.0, 60.0  # s, before and after a way; without one


@dataclass(frozen=True, kw_only=True, eq=False)
class _Found:
    """What was found of one number of carriers and kind.

    Attributes:
        kind: leaning or co_rotating.
        carriers: n.
        phase_turns: κ; 0 for a co-rotating one.
        variables: of the program, forces in shares of f₀.
    """

    kind: str
    carriers: int
    phase_turns: int
    variables: FormationVariables

    @property
    def reserve(self) -> float:
        """Of the margins: 1 where those of the request are just kept, 0 at the limits."""
        return self.variables.reserve

    @property
    def name(self) -> str:
        """Such as "3 co-rotating"."""
        return f"{self.carriers} {self.kind.replace('_', '-')}"


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignedFormation(_Found):
    """A formation that keeps the margins of a request.

    Attributes:
        flight: what the aircraft need at rest and on the way.
        distances: m, the least of two carriers and of two cables, at rest.
        cables: what its straight cables leave out, at rest.
        growth: 1/s, of a deviation of the load, the largest at rest and on the way.
        breaks: what breaks first as wind, load and speed grow.
        scenario: that flies it.
    """

    flight: FlightExtremes
    distances: tuple[float, float]
    cables: BowedCables
    growth: float
    breaks: tuple[Break, ...]
    scenario: Scenario

    @property
    def power(self) -> float:
        """W, that all aircraft draw at rest."""
        return self.carriers * self.flight.power

    @property
    def energy(self) -> float | None:
        """Wh/(kg km) from all batteries, with the power at rest and the load's mean speed.

        None where it rests.
        """
        mean_speed = self.variables.speed / PEAK
        return self.power / (3.6 * self.variables.mass * mean_speed) if mean_speed > 0 else None

    @property
    def forces(self) -> dict[str, float]:
        """C, A_r, A_t and B, N, by the fields of a pattern."""
        return _forces(self.variables, self.carriers)


def _forces(x: FormationVariables, carriers: int) -> dict[str, float]:
    share = x.mass * GRAVITY / carriers  # f₀, N, the load's weight for each cable
    return {name: share * getattr(x, name) for name in x._fields[:4]}


@dataclass(frozen=True, kw_only=True, eq=False)
class Refusal(_Found):
    """Why a number of carriers of a kind does not keep the margins; its variables are the best.

    Attributes:
        missed: what its aircraft need beyond what is asked, in words; "" where that is kept.
        remedy: what would help, which was tried; "" where nothing did.
        fault: what forbids a formation that keeps the margins, such as a load that sways.
    """

    missed: str = ""
    remedy: str = ""
    fault: str = ""

    @property
    def sentence(self) -> str:
        """Why there is no such formation, and what would help."""
        if self.fault:
            return f"not at {self.reserve:.3g} of the margins: {self.fault}"
        remedy = f"; give {self.remedy}" if self.remedy else ""
        return f"none; the best misses {self.missed}{remedy}"


def formation_scenario(
    request: DesignRequest,
    kind: str,
    carriers: int,
    phase_turns: int,
    x: FormationVariables,
    flight: FlightExtremes,
) -> Scenario:
    """The scenario that flies a formation: at rest, along the request's displacement, at rest."""
    angles = 2 * np.pi * np.arange(carriers) / carriers
    ring = request.load_radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    frequency = _rounded(x.frequency)
    move: dict[str, Any] = {}
    duration = _REST_TIME
    if request.speed > 0:
        distance = float(np.linalg.norm(request.displacement))
        time = round(PEAK * distance / request.speed, 2)
        duration = _START_TIME + time + _END_TIME
        # A quintic's jerk steps, and the carriers' velocities with it, by L_c/g of the step.
        move = {
            "blend": "c4",
            "displacement": request.displacement,
            "start_time": _START_TIME,
            "move_time": time,
        }
    forces = {name: _rounded(force) for name, force in _forces(x, carriers).items()}
    if kind == LEANING:
        pattern = {"_tag": "!EllipticCarousel", "phase_turns": phase_turns, **forces}
        trajectory = {"_tag": "!RestToRest", **move}
    else:
        pattern = {"_tag": "!ConstantSpread", "spread": forces["spread"]}
        trajectory = {"_tag": "!SteadyTurn", "yaw_rate": frequency, **move}
    aircraft = {k: v for k, v in vars(request.aircraft).items() if v is not None}
    fields: dict[str, Any] = {
        "simulation_duration": duration,
        "system.load_mass": request.load_mass,
        "system.load_inertia": request.inertia,
        "system.load_drag": request.load_drag,
        "system.attachments": (ring.round(9) + 0.0).tolist(),
        "system.cable_length": _rounded(x.cable_length),
        "system.cable_stiffness": request.cable_stiffness,
        "system.cable_damping": request.cable_damping,
        "system.aircraft": aircraft,
        "pattern": pattern,
        "load_trajectory": trajectory,
        "optimization_layer": {
            "_tag": "!ConstantParameters",
            "frequency": frequency,
            "amplitude": 1.0 if kind == LEANING else 0.0,
            "speed_bound": math.floor(9 * flight.airspeed_min) / 10,
        },
        "carrier_controller.frequency": 1.8 if kind == LEANING else 1.5,
    }
    if np.any(request.wind):
        fields["wind"] = {"_tag": "!SteadyWind", "velocity": request.wind}
    made = load_scenario("aircraft_rest", [as_override(k, v) for k, v in fields.items()])
    kind = kind.replace("_", "-")
    about = f"{carriers} {request.aircraft_name}, {kind}, hold {request.load_mass:g} kg on cables"
    return dataclasses.replace(
        made, name=request.name, description=f"{about} of {x.cable_length:.0f} m"
    )


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
