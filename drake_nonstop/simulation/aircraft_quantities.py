"""The quantities of a run whose carriers are aircraft."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import (
    airspeed_over_loaded_stall,
    stall_speed,
    thrust_limits,
    thrust_power,
    thrust_share,
)
from drake_nonstop.mechanics.planned_orbit import FlightNeeds
from drake_nonstop.mechanics.signals import AircraftState, CarrierStates, LoadReference
from drake_nonstop.model.system import aircraft_in, overridden
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.signal_table import UnknownSignalError

_MOVING = 1e-6  # m/s, of the load's reference; slower it rests
_J_PER_KG_M = 1 / 3.6  # in Wh per kg and km


def has_aircraft(run: Run) -> bool:
    """Whether the carriers of a run are aircraft, whose state it has."""
    system = overridden(run.scenario.system, run.scenario.simulated)
    ports = {name.partition(".")[2] for name in run.signals}
    return system.aircraft is not None and "aircraft_state" in ports


class AircraftQuantities:
    """How the aircraft of a run flew, each quantity computed once.

    Shares, speeds, banks and thrusts are those at every step, k of them, of the n aircraft as they
    were simulated. The power of an aircraft is that of its thrust, T V, none where it windmills;
    the motor takes it from the battery with the aircraft's efficiency.
    """

    def __init__(self, run: Run):
        self.run = run
        self.system = overridden(run.scenario.system, run.scenario.simulated)
        aircraft = aircraft_in(self.system)
        assert aircraft is not None
        self.aircraft = aircraft

    @cached_property
    def state(self) -> AircraftState:
        """Lift coefficient, bank, thrust and airspeed, (k, n) each."""
        return AircraftState.view(self.run.steps["aircraft_state"])

    @cached_property
    def needs(self) -> FlightNeeds:
        """What limits of aircraft hold for, (k, n) each, as it was flown; forces are not known.

        The climb is that through the air, of winds that change linearly between samples.
        """
        rise = CarrierStates.view(self.run.steps["carrier_state"]).velocities[..., 2]
        try:
            vertical = self.run.signal("wind")[:, 2::3]
        except UnknownSignalError:
            vertical = np.zeros((len(self.run.time), rise.shape[1]))
        if np.any(vertical):
            at, times = self.run.steps["time"], self.run.time
            rise = rise - np.stack([np.interp(at, times, w) for w in vertical.T], axis=1)
        state = self.state
        return FlightNeeds(
            airspeed=state.airspeed,
            force=np.full(rise.shape, np.nan),
            lift=state.lift,
            bank=state.bank,
            climb=np.arcsin((rise / np.maximum(state.airspeed, _MOVING)).clip(-1, 1)),
            thrust=state.thrust,
        )

    @property
    def lift_shares(self) -> NDArray:
        """The lift coefficients (k, n), with that of gusts, over the largest."""
        return self.state.lift / self.aircraft.max_lift

    @property
    def airspeeds_over_stall(self) -> NDArray:
        """The airspeeds (k, n) over the stall speed in level flight without a load."""
        return self.state.airspeed / stall_speed(self.aircraft)

    @property
    def thrust_limits(self) -> tuple[NDArray, NDArray]:
        """The least and the largest thrust (k, n) at the airspeeds, N."""
        return thrust_limits(self.aircraft, self.state.airspeed)

    @cached_property
    def largest_lift_share(self) -> float:
        """Of any aircraft."""
        return float(np.max(self.lift_shares))

    @cached_property
    def least_airspeed(self) -> float:
        """Of any aircraft, m/s."""
        return float(np.min(self.state.airspeed))

    @cached_property
    def least_airspeed_over_stall(self) -> float:
        """Of any aircraft."""
        return float(np.min(self.airspeeds_over_stall))

    @cached_property
    def least_airspeed_over_loaded_stall(self) -> float:
        """Of any aircraft, over the stall speed at its load factor, with cable and bank."""
        lift, _, thrust, airspeed = self.state
        ratios = airspeed_over_loaded_stall(self.aircraft, airspeed, lift, thrust)
        return float(np.min(ratios))

    @cached_property
    def thrust_shares(self) -> tuple[float, float]:
        """The least and the largest thrust of any aircraft, over the largest at its airspeed."""
        shares = thrust_share(self.aircraft, self.state.thrust, self.state.airspeed)
        return float(np.min(shares)), float(np.max(shares))

    @cached_property
    def largest_bank(self) -> float:
        """Of any aircraft, to either side, rad."""
        return float(np.max(np.abs(self.state.bank)))

    @cached_property
    def least_thrust(self) -> float:
        """Of any aircraft, N."""
        return float(np.min(self.state.thrust))

    @cached_property
    def largest_thrust(self) -> float:
        """Of any aircraft, N."""
        return float(np.max(self.state.thrust))

    @cached_property
    def powers(self) -> NDArray:
        """Of the aircrafts' thrust, (samples, n), at 100 Hz, W."""
        state = AircraftState.view(self.run.signal("aircraft_state"))
        return thrust_power(state.thrust, state.airspeed)

    @cached_property
    def mean_power(self) -> float:
        """Of an aircraft, over all and the whole run, W."""
        return float(np.mean(self.powers))

    @cached_property
    def energy_per_mass_and_distance(self) -> float | None:
        """From the batteries of all aircraft while the load's reference moves, Wh/(kg km).

        Per mass of the load and length of its reference's path; None where it rests all the time.
        """
        speeds = np.linalg.norm(LoadReference.view(self.run.signal("reference")).velocity, axis=1)
        moves = speeds > _MOVING
        if not np.any(moves):
            return None
        power = self.powers[moves].sum(axis=1).mean() / self.aircraft.efficiency
        return float(_J_PER_KG_M * power / (self.system.load_mass * speeds[moves].mean()))
