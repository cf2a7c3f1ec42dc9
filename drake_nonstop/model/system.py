"""The model that several blocks share: load, cables, carriers and pattern."""

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Optional, Protocol

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.rigid_load import RigidLoad, gravity_wrench
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE
from drake_nonstop.model.aircraft import (
    CABLE_DENSITY,
    CABLE_DIAMETER,
    CABLE_DRAG,
    AircraftParameters,
    make_aircraft,
    merged,
)
from drake_nonstop.model.pattern import InternalForcePattern, check_pattern
from drake_nonstop.validation import (
    StrictFields,
    checked,
    is_number,
    non_negative,
    number_or_list,
    number_with,
    positive,
    require,
    require_array,
    require_non_negative,
    require_positive,
    require_ranges,
)

OFFSET = "pattern_offset"  # N, in L, among the parameters of a block
AIRCRAFT = "aircraft."  # begins the names of an aircraft's fields among them
# Pa, of a braid of Dyneema SK78 over its whole section: half of the 3.3 GPa that the fibre has at
# least (DSM Dyneema, fact sheet of its UHMWPE fibre, CIS YA100, 2010), for its gaps and angles.
_STRENGTH = 1.6e9
_STIFFNESS = "give a number greater than zero, or .inf if the controllers assume no stretch"
_MAX_CARRIERS = 100  # whose blocks take ten seconds to trace
# Fields of the system that are a number for all cables, or a list of one for each.
_NUMBERS = ("length", "stiffness", "damping", "diameter", "drag", "friction", "density")
OF_CABLES = (*(f"cable_{name}" for name in _NUMBERS), "cable_breaking_load")
_positive, _non_negative = map(number_or_list, (require_positive, require_non_negative))


@dataclass(kw_only=True)
class SystemParameters(StrictFields):
    """Load, cables and carriers; the defaults are the paper's (Table I, figures).

    Each property of the cables is a number, or a list with a number for each cable.
    """

    load_mass: float = positive(1.0)  # kg
    load_inertia: list[list[float]] = field(  # kg m², about the centre of mass, in L
        default_factory=lambda: [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.01]]
    )
    load_drag: float = non_negative(0.7)  # N s/m
    load_angular_drag: float = non_negative(0.0)  # N m s/rad
    attachments: list[list[float]] = field(  # m, in L, in the order of the carriers
        default_factory=lambda: [
            [0.75, 0.75, 0.0],
            [-0.75, 0.75, 0.0],
            [-0.75, -0.75, 0.0],
            [0.75, -0.75, 0.0],
        ]
    )
    cable_length: float | list[float] = checked(0.8, _positive)  # m, unstretched
    cable_stiffness: float | list[float] = checked(  # N/m; .inf: the controllers assume no stretch
        500.0, number_or_list(number_with(lambda stiffness: stiffness > 0, _STIFFNESS))
    )
    cable_damping: float | list[float] = checked(0.1, _non_negative)  # N s/m
    cable_diameter: float | list[float] = checked(CABLE_DIAMETER, _non_negative)  # m
    # C_D of air across a cable, of its diameter
    cable_drag: float | list[float] = checked(CABLE_DRAG, _non_negative)
    # C_f of air along a cable, of its circumference
    cable_friction: float | list[float] = checked(0.02, _non_negative)
    cable_density: float | list[float] = checked(CABLE_DENSITY, _non_negative)  # kg/m³
    # N; none: that of Dyneema SK78
    cable_breaking_load: float | list[float] | None = checked(None, _positive)
    carrier_mass: float = positive(0.1)  # kg
    gravity: float = positive(9.81)  # m/s²
    # An SDF or URDF file with load_mass, load_inertia and attachments, read as a scenario is loaded
    load_file: str = ""
    # of load_file, at the attachments, in the order of the carriers
    attachment_frames: list[str] = field(default_factory=list)
    # Carriers that are fixed-wing aircraft; none: points of carrier_mass.
    aircraft: AircraftParameters | None = None


# `simulated` in a scenario: any field of SystemParameters, for the simulated plant only.
SystemOverrides: Any = dataclasses.make_dataclass(
    "SystemOverrides",
    [
        (f.name, Optional[f.type], field(default=None, metadata=f.metadata))  # noqa: UP045
        for f in dataclasses.fields(SystemParameters)
    ],
    bases=(StrictFields,),
    kw_only=True,
)
SystemOverrides.__module__ = __name__  # where to find it in a pickle


def overridden(system: SystemParameters, overrides: Any) -> SystemParameters:
    """The system with the fields replaced that `overrides` names."""
    given = {f.name: getattr(overrides, f.name) for f in dataclasses.fields(overrides)}
    given["aircraft"] = merged(system.aircraft, overrides.aircraft)
    return dataclasses.replace(system, **{k: v for k, v in given.items() if v is not None})


def given_fields(overrides: Any) -> list[str]:
    """The names of the fields that `overrides` gives, with those of an aircraft by `AIRCRAFT`."""
    given = [name for name, value in vars(overrides).items() if value is not None]
    fields = vars(overrides.aircraft) if overrides.aircraft is not None else {}
    is_whole = fields.get("model") is not None
    return given + [AIRCRAFT + name for name, v in fields.items() if is_whole or v is not None]


class PatternConfig(Protocol):
    """The interface of a scenario's `pattern` entry."""

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L."""
        ...


def require_few(field: str, points: int) -> None:
    """Raises ScenarioError for more attachment points than carriers can be flown."""
    require(points <= _MAX_CARRIERS, field, f"{points} points", f"give at most {_MAX_CARRIERS}")


class Model:
    """The system as arrays, checked, with the constants that follow from it.

    Each block takes a model: a controller that of the scenario's `system`, the plant that of
    `simulated`. All arrays are in the load frame, except for the states that the plant's blocks
    declare: `initial_load_state` (13,) and `initial_carrier_state` (6n,), SI, in W. These are of a
    load at rest at the origin with all carriers there, as the equilibrium is not known yet.

    Args:
        pattern: for instance HamiltonianCycleConfig().
        control_period: the controllers' sample time in s, 0 for continuous.
        field: the system's name in error messages.
        overridden: the fields that `simulated` replaces.

    Attributes:
        system, pattern_config, control_period, field, overridden: the arguments.
        n, m: the numbers of carriers and of coordinates of internal forces.
        load: its `mass`, `inertia`, `drag`, `angular_drag` and `gravity`, a `RigidLoad`.
        attachments: (n, 3), m.
        pseudo_inverse: (3n, 6), of the grasp matrix, see `mechanics.grasp`.
        pattern: its `basis` N₀ (3n, m), `phases` (m,) in rad and `offset` (3n,) in N.
        carrier_mass, gravity: kg, of each carrier, and m/s².
        aircraft: the carriers, where they are fixed-wing aircraft, whose mass is `carrier_mass`.
        bears_cable_drag: whether an aircraft has a share of its cable's drag; not where the cables
            have drag themselves.
        cable_shape: the shape of the references' cables, for plans; None: straight.
        cable_length, cable_stiffness, cable_compliance, cable_damping, cable_mass,
            cable_breaking_load: m, N/m, m/N (0 without stretch), N s/m, kg and N, each a number, or
            (n,) of cables that differ.

    Raises:
        ScenarioError: a parameter is out of range, there are fewer than 3 attachments,
            the grasp matrix has a rank below 6, or the pattern would stop a carrier.
    """

    def __init__(
        self,
        system: SystemParameters,
        pattern: PatternConfig,
        control_period: float = 0.0,
        *,
        field: str = "system",
        overridden: Iterable[str] = (),
    ):
        require_ranges(field, system)
        self.aircraft = aircraft_in(system, field)
        self.bears_cable_drag = True
        self.cable_shape: CableShape | None = None
        if self.aircraft is not None:
            mass, stated = float(self.aircraft.mass), system.carrier_mass
            is_given = stated != SystemParameters.carrier_mass or "carrier_mass" in overridden
            remedy = (
                f"leave it out: the carriers are aircraft of {mass:g} kg, {field}.aircraft.mass"
            )
            require(stated == mass or not is_given, f"{field}.carrier_mass", stated, remedy)
            system = dataclasses.replace(system, carrier_mass=mass)
        self.system, self.pattern_config, self.field = system, pattern, field
        self.overridden = frozenset(overridden)
        require(
            is_number(control_period) and (control_period == 0 or control_period >= 1e-4),
            "control_period",
            control_period,
            "give 0 for continuous controllers, or at least 1e-4 s",
        )
        self.control_period = control_period
        self.load = RigidLoad(
            mass=system.load_mass,
            inertia=checked_inertia(f"{field}.load_inertia", system.load_inertia),
            drag=system.load_drag,
            angular_drag=system.load_angular_drag,
            gravity=system.gravity,
        )
        self.carrier_mass = system.carrier_mass
        self.gravity = system.gravity
        name = f"{field}.attachments"
        self.attachments = require_array(
            name, system.attachments, [None, 3], "one position per cable"
        )
        self.n = len(self.attachments)
        require(self.n >= 3, name, system.attachments, "give 3 or more attachment points")
        require_few(name, self.n)
        for key in OF_CABLES:
            value = getattr(system, key)
            remedy = f"give one number for all cables, or a list of {self.n}, one per attachment"
            fits = not isinstance(value, list) or len(value) == self.n
            require(fits, f"{field}.{key}", value, remedy)
        self.cable_length = per_cable(system, "cable_length")
        self.cable_stiffness = per_cable(system, "cable_stiffness")
        self.cable_compliance = 1 / self.cable_stiffness
        self.cable_damping = per_cable(system, "cable_damping")
        self.cable_mass = per_cable(system, "cable_density") * _area(system) * self.cable_length
        self.cable_breaking_load = breaking_load(system)
        grasp = grasp_matrix(self.attachments)
        size = np.max(np.abs(self.attachments))
        scaled = grasp / np.array([[size or 1.0]] * 3 + [[1.0]] * 3)
        require(
            np.linalg.matrix_rank(scaled, tol=1e-6) == 6,
            name,
            system.attachments,
            "the grasp matrix has a rank below 6; give attachment points that are not all "
            "on one line",
        )
        self.pseudo_inverse = np.linalg.pinv(grasp)  # (3n, 6)
        self.initial_load_state = np.eye(LOAD_STATE_SIZE)[0]
        self.initial_carrier_state = np.zeros(6 * self.n)
        self.pattern = pattern.make(self.attachments)
        self.m = len(self.pattern.phases)
        weight = gravity_wrench(system.load_mass, self.gravity)
        check_pattern(self.pattern, self.attachments, (self.pseudo_inverse @ weight).reshape(-1, 3))

    @property
    def load_mass(self) -> float:
        """Mass of the load, kg."""
        return self.system.load_mass

    @property
    def offset_parameter(self) -> tuple[str, ...]:
        """The name of the pattern's offset among a block's parameters; none where it has none."""
        return (OFFSET,) if np.any(self.pattern.offset) else ()

    def number(self, name: str) -> Any:
        """A field of the system, or one of "aircraft.mass" and the like, or `OFFSET`'s (3n,)."""
        if name.startswith(AIRCRAFT):
            return getattr(self.aircraft, name.removeprefix(AIRCRAFT))
        return self.pattern.offset if name == OFFSET else getattr(self.system, name)


def per_cable(system: SystemParameters, name: str) -> Any:
    """A field of `OF_CABLES`: a number of all cables, or an array (n,) of cables that differ."""
    value = getattr(system, name)
    return np.array(value) if isinstance(value, list) else value


def breaking_load(system: SystemParameters) -> float | NDArray:
    """Tension in N that a cable of a system breaks at; inf: it has no diameter."""
    if system.cable_breaking_load is not None:
        return per_cable(system, "cable_breaking_load")
    area = _area(system)
    return np.where(area > 0, _STRENGTH * area, math.inf)[()]


def diameter_of(breaking: Any) -> Any:
    """Diameter in m of a cable that breaks at so many N, a number or an array."""
    return np.sqrt(4 / math.pi / _STRENGTH * breaking)


def _area(system: SystemParameters) -> float | NDArray:
    return math.pi / 4 * per_cable(system, "cable_diameter") ** 2


def aircraft_in(system: SystemParameters | Model, field: str = "system") -> Aircraft | None:
    """The aircraft that the carriers of a system are; None where they are none.

    `field` is the system's name in error messages.

    Raises:
        ScenarioError: a field of them is out of range.
    """
    if isinstance(system, Model) or system.aircraft is None:
        return system.aircraft if isinstance(system, Model) else None
    cables = {
        key: per_cable(system, key) for key in ("cable_length", "cable_diameter", "cable_drag")
    }
    own = f"{field}.aircraft"
    return make_aircraft(system.aircraft, gravity=system.gravity, field=own, **cables)


def checked_inertia(name: str, value: list[list[float]]) -> NDArray:
    """The inertia matrix (3, 3), kg m², of a field of that name.

    Raises:
        ScenarioError: no rigid body has it.
    """
    inertia = require_array(name, value, [3, 3], "rows of the inertia matrix")
    moments = np.linalg.eigvalsh(inertia)
    require(
        np.allclose(inertia, inertia.T, rtol=1e-9, atol=0)
        and moments[0] > 0
        and moments[0] + moments[1] >= moments[2] * (1 - 1e-9),
        name,
        value,
        "give a symmetric, positive definite matrix whose principal moments fulfil the "
        "triangle inequality",
    )
    return inertia
