"""Another simulator as a block of the loop: aircraft with six degrees of freedom, by JSBSim.

`pip install jsbsim`, and give the class in the place of a box's block:

    run = simulate(load_scenario("aircraft_rest"), carrier_dynamics=JsbsimCarriers)

`JsbsimCarriers` is a LeafSystem with the ports of `FixedWingDynamics`, by whose names it is wired.
What any block around another simulator needs is in it:

- an update each 5 ms lets the simulator go a step further, under what the inputs are then;
- what the outputs show in between is interpolated: cables need positions without jumps;
- `trim` sets where a flight starts; the simulator is made anew by the first step after that. The
  aircraft are not in the context: one that was copied during a flight cannot go on.

It has no equations, and so its loop is flown by the diagram. Lift, drag, thrust, lags and limits
are those of the system's aircraft; moments, inertia, surfaces and the autopilot, which flies C_L,
bank and thrust, are in `rascal_110.xml`, in JSBSim's format. The cable pulls at a hook, whose
motion is `carrier_state`: its pull turns the aircraft. Gusts act by JSBSim's wind.

The planet (`planet.xml`) is a ball without rotation, 1e8 m in radius, with 9.81 m/s²: at 200 m from
the origin the vertical leans by 2e-6 rad, and rounding leaves 1e-7 m of the positions. JSBSim's
units are feet and pounds.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsbsim
import numpy as np
from numpy.typing import NDArray
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from drake_nonstop import Model
from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    air_frame,
    angle_of_attack,
    flown_aircraft,
    trimmed_states,
)

HERE = Path(__file__).parent
STEP = 0.005  # s
HOOK = np.array([0.0, 0.0, 0.1])  # m, forward, right and down of the centre of gravity
FOOT, POUND = 0.3048, 0.45359237  # m, kg
POUND_FORCE = POUND * 9.80665  # N
RADIUS = 1e8  # m, of the planet
SETTLING = (0.3, 0.3, 4.0)  # s, in which filters and servos come to rest before the start
NORTH_EAST_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # of W, or back

# The numbers of the model that the file's autopilot and aerodynamics go by.
WRITTEN = "lift_at_zero_angle lift_slope max_lift zero_lift_drag induced_drag cable_drag_share"
WRITTEN += " lift_lag bank_lag thrust_lag max_roll_rate lift_gain thrust_gain"
TOLD = [  # before each step: commands, direction and size of the cable's pull, wind
    *(f"carrier/{name}-command" for name in ("lift", "bank", "thrust")),
    *(f"external_reactions/cable/{name}" for name in ("x", "y", "z", "magnitude")),
    *(f"atmosphere/wind-{axis}-fps" for axis in ("north", "east", "down")),
]
SHOWN = [  # after it
    *(f"position/ecef-{axis}-ft" for axis in "yzx"),  # east, north, up
    *(f"velocities/ecef-{axis}-fps" for axis in "yzx"),
    *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
    *(f"velocities/{axis}-rad_sec" for axis in "pqr"),
    *(f"carrier/{name}" for name in ("lift", "bank", "thrust")),
    "velocities/vt-fps",
]
INTEGRATORS = [
    f"simulation/integrator/{kind}/{motion}"
    for kind in ("rate", "position")
    for motion in ("rotational", "translational")
]


class JsbsimAircraft:
    """One aircraft and its autopilot, in SI units and in W; vectors are (3,)."""

    def __init__(self, aircraft: Aircraft):
        self.aircraft = aircraft
        jsbsim.FGJSBBase().debug_lvl = 0
        self.executive = executive = jsbsim.FGFDMExec(None)
        executive.load_planet(str(HERE / "planet.xml"), False)
        executive.set_property_value("simulation/gravity-model", 0)
        executive.load_model_with_paths("rascal_110", *[str(HERE)] * 3, False)
        executive.set_dt(STEP)
        self.nodes = executive.get_property_manager().get_node()
        self.told, self.shown = ([self.node(name) for name in each] for each in (TOLD, SHOWN))
        for axis, offset in zip("xyz", HOOK * [-1, 1, -1], strict=True):
            place = f"external_reactions/cable/location-{axis}-in"
            self.set(place, self.get(f"inertia/cg-{axis}-in") + 12 * offset / FOOT)
        for field in WRITTEN.split():
            self.set(f"carrier/{field.replace('_', '-')}", getattr(aircraft, field))
        for k in range(3):
            self.set(f"carrier/max-thrust-{k}", aircraft.max_thrust[k])
            self.set(f"carrier/min-thrust-{k}", aircraft.min_thrust[k])
        ballast = (aircraft.mass - self.get("inertia/mass-slugs") * POUND_FORCE / FOOT) / POUND
        self.set("inertia/pointmass-weight-lbs", ballast)
        density = aircraft.air_density * FOOT**4 / POUND_FORCE
        self.set("atmosphere/override/density", density)

    def node(self, name: str) -> Any:
        """A property of JSBSim, which is made where there is none."""
        return self.nodes.get_node(name, True)

    def get(self, name: str) -> float:
        """The value of a property."""
        return self.node(name).get_double_value()

    def set(self, name: str, value: float | NDArray) -> None:
        """Sets a property to a number."""
        self.node(name).set_double_value(float(np.squeeze(value)))

    def start(
        self,
        position: NDArray,
        velocity: NDArray,
        acceleration: NDArray,
        command: NDArray,
        pull: NDArray,
        wind: NDArray,
    ) -> None:
        """Starts in coordinated flight, with filters and servos at rest.

        Position and velocity are the hook's, the acceleration is that of the turn, the command
        C_L, bank (rad) and thrust (N), and the pull that of the cable on the load.
        """
        frame, angle = air_frame(velocity - wind), angle_of_attack(self.aircraft, command[0])
        direction_rate, level = acceleration / frame.airspeed, np.hypot(*frame.forward[:2])
        turn = np.array([0.0, 0.0, -(direction_rate @ frame.right) / level])
        turn = turn + (direction_rate @ frame.up) * frame.right
        lift = frame.lift_direction(np.array(command[1]))
        for duration in SETTLING:  # the first ones for the lift of the elevator
            sine, cosine = np.sin(angle), np.cos(angle)
            forward = cosine * frame.forward + sine * lift
            down = sine * frame.forward - cosine * lift
            R_WB = np.stack([forward, np.cross(down, forward), down], axis=1)
            self.place(position - R_WB @ HOOK, velocity - np.cross(turn, R_WB @ HOOK), R_WB, turn)
            self.settle(duration, command, pull, wind)
            angle = angle + (command[0] - self.get("carrier/lift")) / self.aircraft.lift_slope

    def place(self, centre: NDArray, velocity: NDArray, R_WB: NDArray, turn: NDArray) -> None:
        """Sets the motion of the centre of gravity, the attitude, and the turn in rad/s."""
        east, north, up = centre[0], centre[1], centre[2] + RADIUS
        radius = np.sqrt(east**2 + north**2 + up**2)
        height = (centre @ centre + 2 * RADIUS * centre[2]) / (radius + RADIUS)
        angles = RollPitchYaw(RotationMatrix(NORTH_EAST_DOWN @ R_WB)).vector()
        names = "lat-gc-rad long-gc-rad h-sl-ft phi-rad theta-rad psi-true-rad u-fps v-fps w-fps"
        values = [np.arctan2(north, np.hypot(east, up)), np.arctan2(east, up), height / FOOT]
        values += [*angles, *(R_WB.T @ velocity / FOOT), *(R_WB.T @ turn)]
        for name, value in zip(
            [*names.split(), "p-rad_sec", "q-rad_sec", "r-rad_sec"], values, strict=True
        ):
            self.set(f"ic/{name}", value)
        self.executive.run_ic()

    def settle(self, duration: float, command: NDArray, pull: NDArray, wind: NDArray) -> None:
        """Runs autopilot, filters and servos while the motion waits."""
        schemes = {name: self.get(name) for name in INTEGRATORS}
        for name in INTEGRATORS:
            self.set(name, 0)
        self.set("carrier/motion-waits", 1)
        for _ in range(int(duration / STEP)):
            self.advance(command, pull, wind)
        self.set("carrier/motion-waits", 0)
        for name, scheme in schemes.items():
            self.set(name, scheme)

    def advance(self, command: NDArray, pull: NDArray, wind: NDArray) -> None:
        """Flies a step. JSBSim moves by the forces of the step before, and evaluates new ones."""
        size = np.linalg.norm(pull)
        direction = NORTH_EAST_DOWN @ -pull / max(size, 1e-12)
        values = [*command, *direction, size / POUND_FORCE, *(NORTH_EAST_DOWN @ wind / FOOT)]
        for node, value in zip(self.told, values, strict=True):
            node.set_double_value(value)
        self.executive.run()

    def state(self) -> tuple[NDArray, NDArray, NDArray, list[float]]:
        """Position and velocity of the hook, velocity of the centre, [C_L, bank, thrust, V]."""
        values = np.array([node.get_double_value() for node in self.shown])
        centre, speed = values[:3] * FOOT - [0, 0, RADIUS], values[3:6] * FOOT
        R_WB = NORTH_EAST_DOWN @ RotationMatrix(RollPitchYaw(values[6:9])).matrix()
        position, sweep = centre + R_WB @ HOOK, R_WB @ np.cross(values[9:12], HOOK)
        lift = min(values[12], float(np.squeeze(self.aircraft.max_lift)))
        return position, speed + sweep, speed, [lift, *values[13:15], values[15] * FOOT]


class JsbsimCarriers(LeafSystem):
    """Fixed-wing aircraft as rigid bodies, with the ports of `FixedWingDynamics`."""

    def __init__(self, model: Model):
        super().__init__()
        self._aircraft = flown_aircraft(model.aircraft, model.bears_cable_drag)
        self._n = n = model.n
        self._fleet: list[JsbsimAircraft] = []
        names = ("aircraft_command", "carrier_cable_forces", "wind")
        self._inputs = [self.DeclareVectorInputPort(name, 3 * n) for name in names]
        # Whether they fly, the time of the last step, and what was shown then and is a step later:
        # positions, velocities (3n each), `aircraft_state` (4n) and accelerations (3n).
        start = np.tile(np.append(model.initial_carrier_state, np.zeros(7 * n)), 2)
        self.DeclareDiscreteState(np.concatenate([[0.0, 0.0], start]))
        self.DeclarePeriodicDiscreteUpdateEvent(STEP, 0.0, self._advance)
        known = {self.time_ticket(), self.xd_ticket()}
        for name, first, end in (
            ("carrier_state", 0, 6 * n),
            ("aircraft_state", 6 * n, 10 * n),
            ("carrier_acceleration", 10 * n, 13 * n),
        ):
            calc = self._showing(first, end)
            self.DeclareVectorOutputPort(name, end - first, calc, known)

    def SetCarrierState(self, context: Context, value: NDArray) -> None:  # noqa: N802
        """Sets the start of a flight to positions and velocities (6n,) of the hooks."""
        self._set_start(context, np.append(value, np.zeros(7 * self._n)))

    def trim(self, context: Context, carrier_reference_acceleration: NDArray) -> None:
        """Starts in coordinated flight with these accelerations (3n,), m/s²."""
        _, pull, wind = (port.Eval(context) for port in self._inputs)
        n, carriers = self._n, self.GetOutputPort("carrier_state").Eval(context)
        acceleration = carrier_reference_acceleration
        states = trimmed_states(self._aircraft, carriers, acceleration, pull, wind)
        airspeed = np.linalg.norm((carriers[3 * n :] - wind).reshape(n, 3), axis=1)
        self._set_start(context, np.concatenate([states[: 9 * n], airspeed, acceleration]))

    def _set_start(self, context: Context, shown: NDArray) -> None:
        context.SetDiscreteState(np.concatenate([[0.0, 0.0], shown, shown]))

    def _advance(self, context: Context, discrete_state: DiscreteValues) -> None:
        """Flies from now to the next step, under the inputs of now."""
        n, state = self._n, context.get_discrete_state_vector().CopyToVector()
        is_flying, time, shown = state[0], context.get_time(), state[2 + 13 * n :]
        command, pull, wind = (port.Eval(context) for port in self._inputs)
        command, pull, wind = command.reshape(3, n).T, pull.reshape(n, 3), wind.reshape(n, 3)
        if not is_flying:
            parts = [part.reshape(n, 3) for part in (*np.split(shown[: 6 * n], 2), shown[10 * n :])]
            start = shown[6 * n : 9 * n].reshape(3, n).T
            self._fleet = [JsbsimAircraft(self._aircraft) for _ in range(n)]
            for aircraft, *own in zip(self._fleet, *parts, start, pull, wind, strict=True):
                aircraft.start(*own)
            self._pull, self._speeds = pull, np.array([a.state()[2] for a in self._fleet])
            shown = self._shown(parts[2])
        elif abs(time - state[1]) < STEP / 2:  # where a run goes on from its end
            return
        for aircraft, *own in zip(self._fleet, command, 2 * pull - self._pull, wind, strict=True):
            aircraft.advance(*own)
        self._pull, speeds = pull, self._speeds
        self._speeds = np.array([aircraft.state()[2] for aircraft in self._fleet])
        after = self._shown((self._speeds - speeds) / STEP)
        discrete_state.set_value(np.concatenate([[1.0, time], shown, after]))

    def _shown(self, accelerations: NDArray) -> NDArray:
        positions, velocities, _, flown = zip(*(a.state() for a in self._fleet), strict=True)
        parts = (positions, velocities, np.transpose(flown), accelerations)
        return np.concatenate([np.ravel(part) for part in parts])

    def _showing(self, first: int, end: int) -> Callable[[Context, BasicVector], None]:
        """What an output port shows: these entries, positions by Hermite's cubic polynomial."""

        def calc(context: Context, output: BasicVector) -> None:
            state, m = context.get_discrete_state_vector().value(), 3 * self._n
            before, after = np.split(state[2:], 2)
            s = (context.get_time() - state[1]) / STEP if state[0] else 0.0
            values = before + s * (after - before)
            (p, v), (p_end, v_end) = (each[: 2 * m].reshape(2, m) for each in (before, after))
            if state[0] and first == 0:
                bend, twist = 3 * (p_end - p) - STEP * (2 * v + v_end), STEP * (v + v_end)
                twist = twist - 2 * (p_end - p)
                values[:m] = p + s * (STEP * v + s * (bend + s * twist))
                values[m : 2 * m] = v + s * (2 * bend + 3 * s * twist) / STEP
            output.SetFromVector(values[first:end])

        return calc
