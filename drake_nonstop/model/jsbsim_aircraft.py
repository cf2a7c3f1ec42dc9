"""An aircraft flown by JSBSim, six degrees of freedom with its autopilot, in SI units and in W.

JSBSim (https://jsbsim.sourceforge.net) is the extra `jsbsim`. An aircraft is an XML file of its
own format. One for `JsbsimAircraft` has, in this order of need,

- `<metrics>` with `wingarea`, `wingspan` and `htailarm`; `<mass_balance>`;
- in `<external_reactions>` a `<force name="cable" frame="LOCAL">`, which is set in each step;
- an autopilot that flies the commands `carrier/lift-command` (C_L), `carrier/bank-command` (rad,
  positive to the right) and `carrier/thrust-command` (N), declared in `<flight_control>`;
  While `carrier/motion-waits` is 1, before the start, integrals of errors have to hold;
- `carrier/lift` (C_L before stall), `carrier/bank` (rad, of the lift about the direction of
  flight) and `carrier/thrust` (N), computed by it.

Where it declares properties of the names in `WRITTEN`, they are set to the model's numbers, and so
is the weight of a first `<pointmass>` to what the mass lacks. Other numbers are the file's.

The planet is a ball without rotation, of a radius at which the ground is flat: at 200 m from the
origin the vertical leans by 2e-6 rad. Positions are the Cartesian ones of JSBSim, from which the
radius is subtracted: rounding leaves 1e-7 m. The density of the air is the model's at any height.
"""

import contextlib
import functools
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RollPitchYaw, RotationMatrix

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    angle_of_attack,
    body_attitude,
    north_east_down,
    turn_rate,
)
from drake_nonstop.mechanics.rotation import (
    cross,
    roll_pitch_yaw_to_quaternion,
    rotation_matrix,
)
from drake_nonstop.validation import ScenarioError, require, require_file, require_installed

TABLE = Path(__file__).parent / "jsbsim_table"
_NUMBERS = "lift_at_zero_angle lift_slope max_lift zero_lift_drag induced_drag cable_drag_share "
_NUMBERS += "lift_lag bank_lag thrust_lag max_roll_rate lift_gain thrust_gain"
WRITTEN = {  # the properties under carrier/ that are the model's, by their fields
    **{field: (field.replace("_", "-"),) for field in _NUMBERS.split()},
    **{f"{end}_thrust": tuple(f"{end}-thrust-{k}" for k in range(3)) for end in ("max", "min")},
}
_WAITS = "carrier/motion-waits"
_NEEDED = (
    "external_reactions/cable/magnitude",
    _WAITS,
    *(f"carrier/{name}-command" for name in ("lift", "bank", "thrust")),
    *(f"carrier/{name}" for name in ("lift", "bank", "thrust")),
)
# What is set in each step, and what is read after it.
_TOLD = (
    "carrier/lift-command",
    "carrier/bank-command",
    "carrier/thrust-command",
    *(f"external_reactions/cable/{axis}" for axis in "xyz"),
    "external_reactions/cable/magnitude",
    *(f"atmosphere/wind-{axis}-fps" for axis in ("north", "east", "down")),
)
_MEASURED = (
    *(f"position/ecef-{axis}-ft" for axis in "yzx"),  # east, north, up
    *(f"velocities/ecef-{axis}-fps" for axis in "yzx"),
    *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
    *(f"velocities/{axis}-rad_sec" for axis in "pqr"),
    *(f"carrier/{name}" for name in ("lift", "bank", "thrust")),
    "velocities/vt-fps",
)
_FOOT, _POUND = 0.3048, 0.45359237  # m, kg
_POUND_FORCE = _POUND * 9.80665  # N
_INCH = _FOOT / 12  # m
_SLUG = _POUND_FORCE / _FOOT  # kg
_RADIUS = 1e8  # m, of the planet
_LEAST = 1e-12  # N, beside the size of a force
# s, in which filters and servos come to rest before the start; first for the lift of the elevator
_SETTLING = (0.3, 0.3, 4.0)
_LEAST_VERSION = [1, 3, 3]  # as of the extra: before, what it prints could not be taken
_TRIAL_TIME = 30.0  # s, in which a file is loaded and makes a step
_ALIKE = 1e-3  # relative, of what the file and the model have both
_INTEGRATORS = [
    f"simulation/integrator/{kind}/{motion}"
    for kind in ("rate", "position")
    for motion in ("rotational", "translational")
]
_PLANET = """<?xml version="1.0"?>
<planet name="flat">
  <semimajor_axis unit="FT"> {radius!r} </semimajor_axis>
  <semiminor_axis unit="FT"> {radius!r} </semiminor_axis>
  <rotation_rate unit="RAD/SEC"> 0 </rotation_rate>
  <GM unit="FT3/SEC2"> {strength!r} </GM>
  <J2> 0 </J2>
</planet>
"""
_TRIAL = """
import sys, jsbsim
folder, name = sys.argv[1:]
executive = jsbsim.FGFDMExec(None)
if executive.load_model_with_paths(name, folder, folder, folder, False):
    executive.run_ic()
    executive.run()
"""


class FleetState(NamedTuple):
    """Signals of n aircraft of JSBSim, SI, in W."""

    positions: NDArray  # (n, 3), m, of the hooks, where the cables are fastened
    velocities: NDArray  # (n, 3), m/s, of the hooks
    centre_velocities: NDArray  # (n, 3), m/s, of the centres of gravity
    lift: NDArray  # (n,), C_L before stall
    bank: NDArray  # (n,), rad, positive to the right
    thrust: NDArray  # (n,), N
    airspeed: NDArray  # (n,), m/s


class JsbsimAircraft:
    """One aircraft of a file, with its autopilot.

    Args:
        path: the aircraft's file.
        aircraft: the model's aircraft.
        step: s, of each `advance`.
        hook: (3,), m, where the cable is fastened: forward, right and up of the centre of gravity.
        owner, field: the block's and the model's name in error messages.

    Attributes:
        hook: (3,), m, in body axes.

    Raises:
        ScenarioError: JSBSim is not installed, or does not load the file, the file has not what is
            needed, or is not that of the aircraft, or the hook is not on it.
    """

    def __init__(
        self,
        path: Path,
        aircraft: Aircraft,
        *,
        step: float,
        hook: NDArray,
        owner: str,
        field: str,
    ):
        self._aircraft, self.hook = aircraft, hook * [1, 1, -1]
        with _silence() as messages:
            self._executive = _loaded(path, aircraft, step, f"{owner}.aircraft_file", messages)
        self._owner, self._field, self._path = owner, field, path
        self._root = self._executive.get_property_manager().get_node()
        missing = [name for name in _NEEDED if not self._has(name)]
        if missing:
            remedy = f"it declares no {missing[0]}; add it, see drake_nonstop/model/"
            raise ScenarioError(f"{owner}.aircraft_file = {path}: {remedy}jsbsim_aircraft.py")
        self._check_frame()
        self._check_size()
        self._place_hook(hook)
        self._write_model()
        self._told = [self._root.get_node(name, True) for name in _TOLD]
        self._measured = [self._root.get_node(name, True) for name in _MEASURED]

    def _has(self, name: str) -> bool:
        return self._root.get_node(name, False) is not None

    def _get(self, name: str) -> float:
        return float(self._root.get_node(name, True).get_double_value())

    def _set(self, name: str, value: float) -> None:
        self._root.get_node(name, True).set_double_value(float(value))

    def _check_frame(self) -> None:
        """Raises ScenarioError where the cable's force is not in the frame in which it is told."""
        cables = ElementTree.parse(self._path).iterfind("external_reactions/force[@name='cable']")
        for frame in [cable.get("frame") for cable in cables]:
            remedy = f'its force "cable" has the frame {frame}; give LOCAL: north, east, down'
            require(frame == "LOCAL", f"{self._owner}.aircraft_file", self._path, remedy)

    def _check_size(self) -> None:
        """Raises ScenarioError for a file of another aircraft."""
        shown = (
            ("wing_area", "metrics/Sw-sqft", _FOOT**2, "m^2"),
            ("wing_span", "metrics/bw-ft", _FOOT, "m"),
        )
        for name, property_name, unit, text in shown:
            of_file, wanted = self._get(property_name) * unit, getattr(self._aircraft, name)
            require(
                abs(of_file - wanted) <= _ALIKE * wanted,
                f"{self._field}.aircraft.{name}",
                f"{float(wanted):g}",
                f"{self._path.name} has {of_file:.4g} {text}; give that, or the file of this "
                f"aircraft as {self._owner}.aircraft_file",
            )

    def _place_hook(self, hook: NDArray) -> None:
        file, arm = f"{self._owner}.aircraft_file", self._get("metrics/lh-ft") * _FOOT
        require(arm > 0, file, self._path, "it has no htailarm above zero in <metrics>; give it")
        half = self._get("metrics/bw-ft") * _FOOT / 2
        tail = f"farther than the tail, {arm:.3g} m"
        reach = (
            (arm, f"behind the tail, {arm:.3g} m", f"in front of the aircraft, {tail}"),
            (half, *2 * (f"beyond the tip of the wing, {half:.3g} m",)),
            (arm, f"below the aircraft, {tail}", f"above the aircraft, {tail}"),
        )
        for i, (limit, *places) in enumerate(reach):
            value = float(hook[i])
            remedy = f"it is {places[value > 0]} from the centre of gravity; give a value within"
            remedy += f" {-limit:.3g} and {limit:.3g}"
            require(abs(value) <= limit, f"{self._owner}.hook[{i}]", value, remedy)
        for axis, offset in zip("xyz", hook * [-1, 1, 1], strict=True):
            place = self._get(f"inertia/cg-{axis}-in") + offset / _INCH
            self._set(f"external_reactions/cable/location-{axis}-in", place)

    def _write_model(self) -> None:
        """Sets the file's properties of the model."""
        for field, names in WRITTEN.items():
            values = np.ravel(getattr(self._aircraft, field))
            for name, value in zip(names, values, strict=True):
                if self._has(f"carrier/{name}"):
                    self._set(f"carrier/{name}", value)
        mass = float(np.squeeze(self._aircraft.mass))
        of_file = self._get("inertia/mass-slugs") * _SLUG
        ballast = "inertia/pointmass-weight-lbs"
        if self._has(ballast):
            self._set(ballast, self._get(ballast) + (mass - of_file) / _POUND)
        else:
            require(
                abs(of_file - mass) <= _ALIKE * mass,
                f"{self._field}.aircraft.mass",
                f"{mass:g}",
                f"{self._path.name} has {of_file:.4g} kg; give that, or the file a <pointmass> in "
                "<mass_balance>, which makes up the difference",
            )

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

        Position and velocity are the hook's, the acceleration is that which the aircraft turns
        with, the command C_L, bank (rad) and thrust (N), and the pull that of the cable on the
        load: SI, in W, each (3,).
        """
        told = _told(*(part[None] for part in (command, pull, wind)))[0]
        slope = float(np.squeeze(self._aircraft.lift_slope))
        angle = float(np.squeeze(angle_of_attack(self._aircraft, command[0])))
        with _silence():
            for settling in _SETTLING:
                R_WB = body_attitude(velocity - wind, angle, command[1])
                turning = turn_rate(velocity - wind, acceleration)
                self._place(position, velocity, R_WB, turning)
                self._settle(told, settling)
                angle += (command[0] - self._get("carrier/lift")) / slope

    def _place(self, position: NDArray, velocity: NDArray, R_WB: NDArray, turning: NDArray) -> None:
        """Sets the motion of the hook, the attitude and the angular velocity, rad/s, in W."""
        arm = R_WB @ self.hook
        centre, speed = position - arm, velocity - cross(turning, arm)
        east, north, up = centre[0], centre[1], centre[2] + _RADIUS
        radius = np.sqrt(east**2 + north**2 + up**2)
        height = (centre @ centre + 2 * _RADIUS * centre[2]) / (radius + _RADIUS)
        attitude = RollPitchYaw(RotationMatrix(north_east_down(R_WB.T).T)).vector()
        initial = {
            "lat-gc-rad": np.arctan2(north, np.hypot(east, up)),
            "long-gc-rad": np.arctan2(east, up),
            "h-sl-ft": height / _FOOT,
        }
        initial |= dict(zip(("phi-rad", "theta-rad", "psi-true-rad"), attitude, strict=True))
        body = [*(R_WB.T @ speed / _FOOT), *(R_WB.T @ turning)]
        names = ("u-fps", "v-fps", "w-fps", "p-rad_sec", "q-rad_sec", "r-rad_sec")
        initial |= dict(zip(names, body, strict=True))
        for name, value in initial.items():
            self._set(f"ic/{name}", value)
        self._executive.run_ic()

    def _settle(self, told: NDArray, duration: float) -> None:
        """Runs autopilot, filters and servos while the motion waits."""
        schemes = {name: self._get(name) for name in _INTEGRATORS}
        for name in schemes:
            self._set(name, 0)
        self._set(_WAITS, 1)
        for _ in range(int(duration / self._executive.get_delta_t())):
            self.run(told)
        self._set(_WAITS, 0)
        for name, scheme in schemes.items():
            self._set(name, scheme)

    def run(self, told: NDArray) -> None:
        """A step, with these values of `_TOLD`."""
        for node, value in zip(self._told, told.tolist(), strict=True):
            node.set_double_value(value)
        self._executive.run()

    def measured(self) -> list[float]:
        """The values of `_MEASURED`."""
        return [node.get_double_value() for node in self._measured]


class JsbsimFleet:
    """Aircraft with the same hook that fly together."""

    def __init__(self, aircraft: Sequence[JsbsimAircraft]):
        self._aircraft, self._hook = aircraft, aircraft[0].hook

    def start(
        self,
        positions: NDArray,
        velocities: NDArray,
        accelerations: NDArray,
        commands: NDArray,
        pulls: NDArray,
        winds: NDArray,
    ) -> FleetState:
        """Starts all of them; the arguments are those of `JsbsimAircraft.start`, each (n, 3)."""
        parts = (positions, velocities, accelerations, commands, pulls, winds)
        for aircraft, *own in zip(self._aircraft, *parts, strict=True):
            aircraft.start(*own)
        return self._shown()

    def advance(self, commands: NDArray, pulls: NDArray, winds: NDArray) -> FleetState:
        """Signals a step later; the arguments are as of `start`.

        The pulls are those at the end of the step: JSBSim moves by the forces of the step before,
        and then evaluates the new ones.

        Raises:
            ArithmeticError: JSBSim cannot go on from the state.
        """
        told = _told(commands, pulls, winds)
        try:
            for aircraft, own in zip(self._aircraft, told, strict=True):
                aircraft.run(own)
        except RuntimeError as error:
            raise ArithmeticError(str(error)) from None
        return self._shown()

    def _shown(self) -> FleetState:
        values = np.array([aircraft.measured() for aircraft in self._aircraft])
        centres, speeds = values[:, :3] * _FOOT, values[:, 3:6] * _FOOT
        centres[:, 2] -= _RADIUS
        R_NB = rotation_matrix(roll_pitch_yaw_to_quaternion(values[:, 6:9]))  # N: north, east, down
        sweep = cross(values[:, 9:12], np.broadcast_to(self._hook, centres.shape))
        positions = centres + north_east_down(R_NB @ self._hook)
        velocities = speeds + north_east_down((R_NB @ sweep[..., None])[..., 0])
        lift, bank, thrust, airspeed = values[:, 12:].T
        return FleetState(positions, velocities, speeds, lift, bank, thrust, airspeed * _FOOT)


def _told(commands: NDArray, pulls: NDArray, winds: NDArray) -> NDArray:
    """The values (n, 10) of `_TOLD`."""
    sizes = np.sqrt((pulls * pulls).sum(axis=1, keepdims=True))
    directions = north_east_down(-pulls) / np.maximum(sizes, _LEAST)
    parts = (commands, directions, sizes / _POUND_FORCE, north_east_down(winds) / _FOOT)
    return np.concatenate(parts, axis=1)


def aircraft_file(given: str, model: str | None, owner: str, field: str) -> Path:
    """The file at a given path, or, where that is empty, the package's of a model of the table.

    `owner` and `field` are the block's and the model's name in error messages.

    Raises:
        ScenarioError: the package has none, or there is no file of that path.
    """
    if given:
        name = f"{owner}.aircraft_file"
        remedy = "give the path of an aircraft's .xml file"
        require_file(given, name, remedy)
        path = Path(given).absolute()
        require(path.suffix == ".xml", name, given, remedy)
        fault = _fault(path, path.stat().st_mtime_ns)
        if fault:
            raise _not_loaded(name, path, fault)
        return path
    names = sorted(path.stem for path in TABLE.glob("*.xml"))
    require(
        model in names,
        f"{field}.aircraft.model",
        model,
        f"the package has no JSBSim file of it; give {' or '.join(names)}, or the path of one as "
        f"{owner}.aircraft_file",
    )
    return TABLE / f"{model}.xml"


@functools.cache
def _fault(path: Path, changed: int) -> str:
    """Why JSBSim cannot fly a file that was last changed then; empty where it can, or tells later.

    Some errors of a file, such as a property that nothing declares, end the process that flies it.
    So a process of its own tries the file first.
    """
    command = [sys.executable, "-c", _TRIAL, str(path.parent), path.stem]
    options: dict[str, Any] = {"capture_output": True, "text": True, "timeout": _TRIAL_TIME}
    try:
        tried = subprocess.run(command, check=False, **options)
    except subprocess.TimeoutExpired:
        return f"it has made no step after {_TRIAL_TIME:g} s"
    if tried.returncode == 0:
        return ""
    lines = [line.strip() for line in tried.stderr.splitlines() if line.strip()]
    told = [line.removeprefix("what():").strip() for line in lines if line.startswith("what():")]
    return (told or lines or [f"its process ends with {tried.returncode}"])[-1]


def require_jsbsim(owner: str) -> None:
    """Raises ScenarioError where JSBSim, of the version of the extra, is not installed."""
    require_installed(owner, jsbsim="drake-nonstop[jsbsim]")
    version = metadata.version("jsbsim")
    remedy = "it is too old; `pip install 'drake-nonstop[jsbsim]'`"
    numbers = [int(part) for part in re.findall(r"\d+", version)[:3]]
    require(numbers >= _LEAST_VERSION, owner, f"jsbsim {version}", remedy)


def _loaded(path: Path, aircraft: Aircraft, step: float, field: str, messages: list[str]) -> Any:
    """A JSBSim executive with the aircraft and a planet of the model's gravity."""
    import jsbsim

    executive = jsbsim.FGFDMExec(None)
    executive.set_debug_level(0)
    gravity = float(np.squeeze(aircraft.gravity))
    with tempfile.TemporaryDirectory() as folder:
        planet = Path(folder) / "planet.xml"
        radius = _RADIUS / _FOOT
        strength = gravity / _FOOT * radius**2
        planet.write_text(_PLANET.format(radius=radius, strength=strength), encoding="utf-8")
        executive.load_planet(str(planet), False)
    executive.set_property_value("simulation/gravity-model", 0)
    folder, causes = str(path.parent), ""
    try:
        is_loaded = executive.load_model_with_paths(path.stem, folder, folder, folder, False)
    except RuntimeError as error:
        is_loaded, causes = False, str(error)
    if not is_loaded:
        lines = [" ".join(line.split()) for line in (causes, *messages)]
        raise _not_loaded(field, path, next((line for line in lines if line), "without a reason"))
    executive.set_dt(step)
    density = float(np.squeeze(aircraft.air_density)) / _SLUG * _FOOT**3
    node = executive.get_property_manager().get_node("atmosphere/override/density", True)
    node.set_double_value(density)
    return executive


def _not_loaded(field: str, path: Path, cause: str) -> ScenarioError:
    return ScenarioError(
        f"{field} = {path}: JSBSim does not load it ({cause.rstrip('.')}); correct the file, or "
        "leave the field out for the package's own"
    )


@contextlib.contextmanager
def _silence() -> Iterator[list[str]]:
    """Collects what JSBSim would print, as a list of its errors."""
    import jsbsim

    class Listener(jsbsim.DefaultLogger):
        def __init__(self) -> None:
            super().__init__(jsbsim.LogLevel.FATAL)
            self.level = jsbsim.LogLevel.BULK

        def set_level(self, level: Any) -> None:
            self.level = level

        def file_location(self, filename: str, line: int) -> None:
            pass

        def message(self, message: str) -> None:
            if self.level in (jsbsim.LogLevel.ERROR, jsbsim.LogLevel.FATAL):
                messages.append(message)

        def format(self, kind: Any) -> None:
            pass

        def flush(self) -> None:
            pass

    messages: list[str] = []
    before = jsbsim.get_logger()
    jsbsim.set_logger(Listener())
    try:
        yield messages
    finally:
        jsbsim.set_logger(before)
