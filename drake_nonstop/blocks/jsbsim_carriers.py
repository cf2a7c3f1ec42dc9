"""The variant of box "Carrier Dynamics" that JSBSim flies: aircraft with six degrees of freedom."""

import itertools
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues
from pydrake.systems.primitives import AffineSystem

from drake_nonstop.mechanics.aircraft import (
    FlightStates,
    air_frame,
    flown_aircraft,
    is_stalled,
    trimmed_states,
)
from drake_nonstop.mechanics.carrier import carriers_kinetic_energy, carriers_potential_energy
from drake_nonstop.mechanics.signals import AircraftState, CarrierStates
from drake_nonstop.model.block import (
    required_aircraft,
)
from drake_nonstop.model.jsbsim_aircraft import (
    FleetState,
    JsbsimAircraft,
    JsbsimFleet,
    aircraft_file,
    require_jsbsim,
)
from drake_nonstop.model.system import AIRCRAFT, Model
from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    fulfilling,
    require,
    require_ranges,
    vector,
)

_BOX = "carrier_dynamics"
_SELF = f"{_BOX} = JsbsimCarriers"
_REASON = "JSBSim keeps the state of its aircraft outside of the context, where nothing copies it"
_numbers = itertools.count(1)  # of flights, one for all diagrams: a context knows its own


@dataclass(kw_only=True)
class JsbsimCarriersConfig(StrictFields):
    """The aircraft's file, the hook, the step, and what a stall does to a run."""

    aircraft_file: str = ""  # path of a JSBSim aircraft; empty: the package's of system.aircraft
    # m, the cable's end, forward, right and up of the centre of gravity
    hook: list[float] = vector([0.0, 0.0, -0.1], "m forward, right and up of the centre of gravity")
    step: float = fulfilling(  # s, of JSBSim, from 0.001 to 0.01
        0.005,
        lambda step: 0.001 <= step <= 0.01,
        "give 0.001 to 0.01 s, which the autopilot is made for",
    )
    stops_at_stall: bool = (
        True  # the run ends at the first stall; false: with stalled lift it goes on
    )


class JsbsimCarriers(DiagramBlock):
    """Fixed-wing aircraft as rigid bodies, each flown by a JSBSim of its own with an autopilot.

    The ports are those of `FixedWingDynamics`, whose place it takes by one line. Lift, drag,
    thrust, limits and lags are those of the system's aircraft; moments, side force, inertia and
    surfaces those of its file, see `drake_nonstop.model.jsbsim_aircraft`. Elevator, ailerons,
    rudder and throttle follow the commands by the autopilot in that file. The cable pulls at the
    hook: `carrier_state` is the hook's, and so its pull turns the aircraft, too. Gusts act by
    JSBSim's wind, without `gust_time`. What JSBSim prints is not shown.

    Each `step` the aircraft fly from that instant to the next, under the command and the wind of
    that instant, and the cable's pull extrapolated to the next; in between the outputs are
    interpolated, positions and velocities by a cubic polynomial, so that they are continuous. The
    first step starts them trimmed: coordinated flight with the C_L, the bank and the thrust that
    the point mass starts with, surfaces and throttle at rest. A run that starts again does so,
    too, with aircraft made anew: runs repeat to the bit. It starts at a multiple of `step`.

    JSBSim needs the extra: `pip install drake-nonstop[jsbsim]`. It keeps the aircraft's state
    outside of the context. So this block, and a diagram with it, has no `Clone` and no conversion
    to AutoDiffXd or Expression, and a context that was copied during a flight cannot go on once
    the other one has.

    Positions and velocities are those of the hooks, `carrier_acceleration` that of the centres of
    gravity, the mean over the last step.

    Raises:
        ScenarioError: the system has no aircraft; JSBSim is not installed, or does not load the
            file, or that is the file of another aircraft; the hook is not on the aircraft; a field
            is out of its range. As it runs: its context was copied from another one that has flown
            on, its time was set, or it starts between two steps.
    """

    reads = ("aircraft_command", "carrier_cable_forces", "wind")
    makes = ("carrier_state", "aircraft_state", "carrier_acceleration")

    has_state_outside = True
    ending_signal = "aircraft_state"

    def __init__(self, model: Model, config: JsbsimCarriersConfig | None = None):
        super().__init__()
        config = config or JsbsimCarriersConfig()
        hangar = _Hangar(model, config)
        self._aircraft, self._stops_at_stall = hangar.aircraft, config.stops_at_stall
        n, builder = model.n, DiagramBuilder()
        # Drake's, since a LeafSystem in Python cannot have its default state set.
        stays = np.eye(12 * n)
        start = AffineSystem(A=stays, C=stays, time_period=config.step)
        start.configure_default_state(np.append(model.initial_carrier_state, np.zeros(6 * n)))
        self._start = builder.AddNamedSystem("start", start)
        self._flights = builder.AddNamedSystem("flights", _Flights(hangar))
        builder.Connect(start.get_output_port(), self._flights.GetInputPort("start"))
        for name in self.reads:
            builder.ExportInput(self._flights.GetInputPort(name), name)
        for name in self.makes:
            builder.ExportOutput(self._flights.GetOutputPort(name), name)
        builder.BuildInto(self)

    def SetCarrierState(self, context: Context, value: NDArray) -> None:
        own = self.GetMutableSubsystemContext(self._start, context)
        states = own.get_discrete_state_vector().CopyToVector()
        states[: len(value)] = value
        self._set_start(context, states)

    def trim(self, context: Context, carrier_reference_acceleration: NDArray) -> None:
        """Sets C_L, bank and thrust, within their limits, for these accelerations (3n,), m/s²."""
        pull, wind = (self.GetInputPort(name).Eval(context) for name in self.reads[1:])
        state = self.GetOutputPort("carrier_state").Eval(context)
        acceleration = carrier_reference_acceleration
        states = trimmed_states(self._aircraft, state, acceleration, pull, wind)
        flying = FlightStates.view(states)
        kept = (flying.carriers, flying.lift, flying.bank, flying.thrust, acceleration)
        self._set_start(context, np.concatenate(_Start(*kept)))

    def _set_start(self, context: Context, states: NDArray) -> None:
        self.GetMutableSubsystemContext(self._start, context).SetDiscreteState(states)
        flights = self.GetMutableSubsystemContext(self._flights, context)
        flights.SetDiscreteState(np.zeros(flights.num_total_states()))

    def ends_run(self, context: Context, shown: NDArray) -> bool:
        """Whether an aircraft is stalled by the `aircraft_state`, and a run ends there."""
        return self._stops_at_stall and bool(np.any(is_stalled(self._aircraft, shown)))

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m Σ ‖v_i‖², J, without rotation; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        return float(np.sum(carriers_kinetic_energy(state, mass=self._aircraft.mass)))

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Potential energy of the weights, m g Σ z_i, J; the context is the block's own."""
        state, own = self.GetOutputPort("carrier_state").Eval(context), self._aircraft
        energy = carriers_potential_energy(state, mass=own.mass, gravity=own.gravity)
        return float(np.sum(energy))


def _refusal() -> ScenarioError:
    return ScenarioError(
        f"{_SELF}: a diagram with it has no Clone and no conversion to AutoDiffXd or Expression: "
        f"{_REASON}; make the diagram again from its scenario, or choose FixedWingDynamics"
    )


class _Start(NamedTuple):
    """States that n aircraft start with."""

    carriers: NDArray  # (6n,), [positions (m), velocities (m/s)]
    lift: NDArray  # (n,), C_L
    bank: NDArray  # (n,), rad
    thrust: NDArray  # (n,), N
    acceleration: NDArray  # (3n,), m/s²

    @classmethod
    def view(cls, values: NDArray) -> "_Start":
        """The parts of an array (12n,)."""
        return cls(*np.split(values, len(values) // 12 * np.array([6, 7, 8, 9])))

    def commands(self) -> NDArray:
        """C_L, bank and thrust of each (n, 3)."""
        return np.stack([self.lift, self.bank, self.thrust], axis=1)


class _Shown(NamedTuple):
    """Signals of n aircraft at an instant."""

    carriers: NDArray  # (6n,), [positions (m), velocities (m/s)]
    aircraft: NDArray  # (4n,), `AircraftState`
    acceleration: NDArray  # (3n,), m/s²

    @classmethod
    def view(cls, values: NDArray) -> "_Shown":
        """The parts of an array (13n,)."""
        n = len(values) // 13
        return cls(values[: 6 * n], values[6 * n : 10 * n], values[10 * n :])


class _Hangar:
    """Makes the aircraft of flights; they are checked once, as the block is made."""

    def __init__(self, model: Model, config: JsbsimCarriersConfig):
        own = required_aircraft(model, _BOX, "JsbsimCarriers")
        self.aircraft = flown_aircraft(own, model.bears_cable_drag)
        require_jsbsim(_BOX)
        require_ranges(_BOX, config)
        self.n, self.step, hook = model.n, config.step, np.array(config.hook, float)
        parameters = model.system.aircraft
        name = None if parameters is None else parameters.model
        is_given = any(name.startswith(AIRCRAFT) for name in model.overridden)
        told = model.field if is_given else "system"
        file, own = aircraft_file(config.aircraft_file, name, _BOX, told), self.aircraft
        self.made = partial(  # a new aircraft
            JsbsimAircraft, file, own, step=self.step, hook=hook, owner=_BOX, field=told
        )
        self.made()


class _Flight:
    """The aircraft that fly, from the step at which they start."""

    def __init__(self, hangar: _Hangar):
        self.number, self.steps = next(_numbers), 0
        self._step, self._most_lift = hangar.step, float(np.squeeze(hangar.aircraft.max_lift))
        self._fleet = JsbsimFleet([hangar.made() for _ in range(hangar.n)])
        self._pulls: NDArray = np.zeros((0, 3))  # (n, 3), N, at the start of the step before
        self._velocities: NDArray = np.zeros((0, 3))  # (n, 3), m/s, of the centres of gravity

    def start(self, states: NDArray, pull: NDArray, wind: NDArray) -> NDArray:
        """Starts; returns `_Shown` (13n,) of that instant."""
        start = _Start.view(states)
        positions, velocities = CarrierStates.view(start.carriers)
        accelerations, self._pulls = start.acceleration.reshape(-1, 3), pull.reshape(-1, 3)
        winds, commands = wind.reshape(-1, 3), start.commands()
        shown = self._fleet.start(
            positions, velocities, accelerations, commands, self._pulls, winds
        )
        self._velocities = shown.centre_velocities
        return self._shown(shown, accelerations)

    def advance(self, command: NDArray, pull: NDArray, wind: NDArray) -> NDArray:
        """Flies a step; returns `_Shown` (13n,) of the next instant."""
        before, self._pulls = self._pulls, pull.reshape(-1, 3)
        told = command.reshape(3, -1).T
        shown = self._fleet.advance(told, 2 * self._pulls - before, wind.reshape(-1, 3))
        self.steps += 1
        before, self._velocities = self._velocities, shown.centre_velocities
        return self._shown(shown, (self._velocities - before) / self._step)

    def _shown(self, shown: FleetState, accelerations: NDArray) -> NDArray:
        carriers = CarrierStates(shown.positions, shown.velocities).flat()
        lift = np.minimum(shown.lift, self._most_lift)
        aircraft = np.concatenate(AircraftState(lift, shown.bank, shown.thrust, shown.airspeed))
        return np.concatenate(_Shown(carriers, aircraft, accelerations.ravel()))


class _Flights(InnerBlock):
    """Flies the aircraft, and shows them.

    The state is [the flight's number, or 0 before its start; its steps; the time (s) at which the
    last one began; `_Shown` (13n) at that time, and a step later].
    """

    def __init__(self, hangar: _Hangar):
        if self.scalar is not float:
            raise _refusal()
        super().__init__()
        self._hangar = hangar
        self._flight: _Flight | None = None
        n = hangar.n
        self._start = self.DeclareVectorInputPort("start", 12 * n)
        self._inputs = [self.DeclareVectorInputPort(name, 3 * n) for name in JsbsimCarriers.reads]
        self.DeclareDiscreteState(3 + 26 * n)
        ports = self._start, *self._inputs
        start, *_, wind = (self.input_port_ticket(port.get_index()) for port in ports)
        known = {self.time_ticket(), self.xd_ticket(), start}
        self.DeclareVectorOutputPort("carrier_state", 6 * n, self._calc_carriers, known)
        self.DeclareVectorOutputPort("aircraft_state", 4 * n, self._calc_aircraft, {*known, wind})
        self.DeclareVectorOutputPort("carrier_acceleration", 3 * n, self._calc_acceleration, known)
        self.DeclarePeriodicDiscreteUpdateEvent(hangar.step, 0.0, self._advance)
        self.DeclareInitializationDiscreteUpdateEvent(self._require_multiple)

    def Clone(self) -> Any:
        raise _refusal()

    def _require_multiple(self, context: Context, discrete_state: DiscreteValues) -> None:
        """Raises ScenarioError for a start between two steps."""
        time, step = context.get_time(), self._hangar.step
        is_flying = context.get_discrete_state_vector().value()[0] > 0
        remedy = f"start at a multiple of {_BOX}.step, {step:g} s"
        is_multiple = abs(time - round(time / step) * step) < 1e-6 * step
        require(is_flying or is_multiple, "time", time, remedy)

    def _advance(self, context: Context, discrete_state: DiscreteValues) -> None:
        state, time = context.get_discrete_state_vector().CopyToVector(), context.get_time()
        number, steps, began = state[:3]
        step = self._hangar.step
        command, pull, wind = (port.Eval(context) for port in self._inputs)
        shown = state[(3 + len(state)) // 2 :]
        flight = self._flight
        if number == 0:
            flight = self._flight = _Flight(self._hangar)
            shown = flight.start(self._start.Eval(context), pull, wind)
        else:
            self._require_own(flight, number, steps)
            if abs(time - began) < step / 2:  # where a run goes on from its end
                return
            remedy = f"{_REASON}; set no time during a flight, or start it again by set_equilibrium"
            require(abs(time - began - step) < step / 2, f"time of {_SELF}", time, remedy)
        assert flight is not None
        try:
            after = flight.advance(command, pull, wind)
        except ArithmeticError:
            raise NotFiniteError(self.box()) from None
        if not np.linalg.norm(after) < LARGEST:
            raise NotFiniteError(self.box())
        discrete_state.set_value(
            np.concatenate([[flight.number, flight.steps, time], shown, after])
        )

    def _require_own(self, flight: _Flight | None, number: float, steps: float) -> None:
        """Raises ScenarioError where the aircraft are not those of the context."""
        if flight is None or (flight.number, flight.steps) != (number, steps):
            raise ScenarioError(
                f"{_SELF}: this context was copied, and its aircraft have flown on with another "
                f"one: {_REASON}; start it again by set_equilibrium(diagram, context), make a "
                "diagram for each run, or, as for the stability analysis, choose FixedWingDynamics"
            )

    def _interpolation(self, context: Context) -> tuple[_Shown, _Shown, float] | None:
        """Signals before and after the present instant, and its share of the step."""
        state = context.get_discrete_state_vector().value()
        if state[0] == 0:
            return None
        half = (3 + len(state)) // 2
        before, after = _Shown.view(state[3:half]), _Shown.view(state[half:])
        return before, after, (context.get_time() - state[2]) / self._hangar.step

    def _calc_carriers(self, context: Context, output: Any) -> None:
        flying = self._interpolation(context)
        if flying is None:
            output.set_value(_Start.view(self._start.Eval(context)).carriers)
            return
        before, after, share = flying
        output.set_value(_cubic(before.carriers, after.carriers, share, self._hangar.step))

    def _calc_aircraft(self, context: Context, output: Any) -> None:
        flying = self._interpolation(context)
        if flying is not None:
            before, after, share = flying
            output.set_value(before.aircraft + share * (after.aircraft - before.aircraft))
            return
        start = _Start.view(self._start.Eval(context))
        velocities = CarrierStates.view(start.carriers).velocities
        winds = self._inputs[-1].Eval(context).reshape(-1, 3)
        airspeed = air_frame(velocities - winds).airspeed[..., 0]
        shown = AircraftState(start.lift, start.bank, start.thrust, airspeed)
        output.set_value(np.concatenate(shown))

    def _calc_acceleration(self, context: Context, output: Any) -> None:
        flying = self._interpolation(context)
        if flying is None:
            output.set_value(_Start.view(self._start.Eval(context)).acceleration)
            return
        before, after, share = flying
        output.set_value(before.acceleration + share * (after.acceleration - before.acceleration))


def _cubic(before: NDArray, after: NDArray, share: float, step: float) -> NDArray:
    """Carriers (6n,) at a share of a step between two states: Hermite's cubic polynomial."""
    (p, v), (p_end, v_end) = CarrierStates.view(before), CarrierStates.view(after)
    s, moved = share, p_end - p
    bend, twist = 3 * moved - step * (2 * v + v_end), step * (v + v_end) - 2 * moved
    positions = p + s * (step * v + s * (bend + s * twist))
    velocities = v + s * (2 * bend + 3 * s * twist) / step
    return CarrierStates(positions, velocities).flat()
