"""Request for the design of a formation of aircraft."""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.analysis.flight_envelope import FlightEnvelope
from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.model.aircraft import CABLE_DIAMETER, AircraftParameters, make_aircraft
from drake_nonstop.model.system import checked_inertia
from drake_nonstop.planning.formation_program import KINDS
from drake_nonstop.planning.problem_config import AircraftLimits, check_flight_limits, points
from drake_nonstop.scenario.describe import commented_fields
from drake_nonstop.scenario.fields import Walk
from drake_nonstop.scenario.overrides import parse_override
from drake_nonstop.scenario.schema import check_name
from drake_nonstop.scenario.yaml_text import dump_plain, parse_plain
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    non_negative,
    one_of,
    positive,
    read_text,
    require,
    require_array,
    require_known,
    require_ranges,
    require_seed,
    vector,
)

GRAVITY = 9.81  # m/s²
_CABLES = (1.0, 5000.0)  # m
_WAY_TIMES = (1.0, 36000.0)  # s, the way's length by the largest speed
_MOST_CARRIERS = 12
_LIMITS = FlightEnvelope()
MARGIN, POWER = "margin", "power"
STRAIGHT, LUMPED = "straight", "lumped"


def _within(low: float, high: float, unit: str) -> Callable[[str, Any], None]:
    """A check of what a formation can have to do with, far beyond any that was flown."""

    def check(field: str, value: Any) -> None:
        size = np.linalg.norm(value) if isinstance(value, list) else value
        require(low <= size <= high, field, value, f"give {low:g} to {high:g} {unit}")

    return check


def _below(default: float, limit: float) -> Any:
    remedy = f"give a number above 0 and below {limit:.3g}, the limit"
    return fulfilling(default, lambda value: 0 < value < limit, remedy)


@dataclass(kw_only=True)
class _Asked(StrictFields):
    name: str = "formation"  # of the scenarios that are made
    description: str = ""
    aircraft: AircraftParameters = field(
        default_factory=lambda: AircraftParameters(model="rascal_110")
    )
    carriers: list[int] = field(default_factory=lambda: [3, 4, 5, 6])  # numbers to be tried
    kinds: list[str] = field(default_factory=lambda: [*KINDS])  # leaning, co_rotating
    load_mass: float = checked(10.0, _within(1e-3, 1e5, "kg"))  # kg
    # m, of the circle through the attachments
    load_radius: float = checked(1.5, _within(1e-3, 1e3, "m"))
    load_inertia: list[list[float]] | None = None  # kg m², in L; none: a disc of that radius
    load_drag: float = checked(0.6, _within(0.0, 1e4, "N s/m"))  # N s/m
    cable_length: list[float] = field(default_factory=lambda: [60.0, 200.0])  # m, least and largest
    cable_diameter: float = checked(CABLE_DIAMETER, _within(0.0, 0.1, "m"))  # m
    # breaking load over the largest tension, from which the diameter follows; 0: that is given
    cable_safety: float = checked(0.0, _within(0.0, 100.0, ""))
    # straight, or lumped: with mass, drag, and references that know of their bow
    cables: str = checked(STRAIGHT, one_of((STRAIGHT, LUMPED), f"give {STRAIGHT} or {LUMPED}"))
    cable_stiffness: float = checked(120.0, _within(1e-2, 1e7, "N/m"))  # N/m
    cable_damping: float = checked(2.0, _within(0.0, 1e6, "N s/m"))  # N s/m
    # m/s, in W
    wind: list[float] = vector([0.0, 0.0, 0.0], "m/s, in W", _within(0.0, 100.0, "m/s"))
    gust: float = checked(0.0, _within(0.0, 20.0, "m/s"))  # m/s, standard deviation of gusts
    # m, of the load
    displacement: list[float] = vector([50.0, 0.0, 0.0], "m, in W", _within(0.0, 1e6, "m"))
    speed: float = non_negative(1.25)  # m/s, the load's largest on the way; 0: it rests
    separation: float = positive(12.0)  # m, of any two carriers, at least
    # of C_Lmax, at most; less than where a controller saturates
    lift_share: float = _below(0.8, _LIMITS.lift_share)
    # of the stall speed, at least; more than where thrust is added
    speed_share: float = fulfilling(
        1.25,
        lambda share: _LIMITS.speed_share < share <= 10,
        f"give a number above {_LIMITS.speed_share:g}, the limit, up to 10",
    )
    # rad, at most; less than where a controller saturates
    bank: float = _below(0.75, _LIMITS.bank)
    # rad, up or down at most; a formation beyond 0.52 is refused
    climb: float = _below(0.45, _LIMITS.climb)
    # of the range of thrust at an airspeed, kept at both of its ends
    thrust_reserve: float = _below(0.1, 0.5)
    # what the first formation has: the largest margin, or the least power
    first: str = checked(MARGIN, one_of((MARGIN, POWER), f"give {MARGIN} or {POWER}"))
    starts: int = points(4, 100)  # of the search for each number of carriers and kind
    seed: int = checked(0, require_seed)  # of the starts


@dataclass(kw_only=True)
class DesignRequest(AircraftLimits, _Asked):
    """Aircraft, load, wind and margins: what `design` finds formations for.

    The attachments are a regular polygon about the load's centre of mass. The margins, and the
    limits of aircraft, hold at rest and on the way of the load, from rest to rest along
    `displacement`; the separation at rest in still air. In gusts, which may take three of their
    standard deviations from an airspeed, lift and airspeed stay within the aircraft's own limits,
    and each formation is flown in gusts 1.25 times as strong before it is returned.
    """

    def check(self) -> Aircraft:
        """The aircraft, of a cable of the largest length.

        Raises:
            ScenarioError: a field cannot be used.
        """

        def need(condition: Any, name: str, remedy: str) -> None:
            require(condition, f"request.{name}", getattr(self, name), remedy)

        Walk(reads_trees=False).read("request", DesignRequest, self)
        check_name(self.name)
        need(self.carriers, "carriers", "give numbers of carriers, such as [3, 4]")
        is_some = all(3 <= n <= _MOST_CARRIERS for n in self.carriers)
        need(is_some, "carriers", f"give numbers from 3 to {_MOST_CARRIERS}")
        need(self.kinds, "kinds", f"give some of {', '.join(KINDS)}")
        for kind in self.kinds:
            require_known(kind, KINDS, "request.kinds", self.kinds)
        for name in ("carriers", "kinds"):
            values = getattr(self, name)
            need(len(set(values)) == len(values), name, "give each of them once")
        require_ranges("request", self)
        way = np.array(self.displacement, float)
        short, long = require_array("request.cable_length", self.cable_length, [2], "m, in order")
        remedy = "give the least and the largest, above zero, in this order"
        need(0 < short <= long, "cable_length", remedy)
        least, most = _CABLES
        is_usable = least <= short and long <= most
        need(is_usable, "cable_length", f"give lengths from {least:g} to {most:g} m")
        reach = 2 * (self.load_radius + long)
        remedy = f"give at most {reach:.3g}, twice the reach of the longest cable"
        need(self.separation <= reach, "separation", remedy)
        remedy = "give a way other than none, or speed = 0 for a load that rests"
        need(np.any(way) or self.speed == 0, "displacement", remedy)
        if self.speed > 0:
            slow, fast = (float(np.linalg.norm(way)) / time for time in _WAY_TIMES[::-1])
            remedy = f"give {slow:.2g} to {fast:.2g}, for the length of the way, or 0 for none"
            need(slow <= self.speed <= fast, "speed", remedy)
        checked_inertia("request.load_inertia", self.inertia)
        aircraft = make_aircraft(
            self.aircraft,
            cable_length=float(long),
            gravity=GRAVITY,
            cable_diameter=self.cable_diameter,
            field="request.aircraft",
        )
        check_flight_limits("request", self, aircraft)
        return aircraft

    @property
    def inertia(self) -> list[list[float]]:
        """The load's, as given or that of a disc."""
        if self.load_inertia is not None:
            return self.load_inertia
        flat = self.load_mass * self.load_radius**2 / 4
        return np.diag([flat, flat, 2 * flat]).tolist()

    @property
    def aircraft_name(self) -> str:
        """Name of the aircraft in sentences."""
        return self.aircraft.model or "aircraft of its own"


def read_request(file: str | Path | None = None, overrides: Sequence[str] = ()) -> DesignRequest:
    """The request in a YAML file, or the default one, with changes "path=value".

    The file's keys are the fields of `DesignRequest`; the name is the file's by default. Changes
    are such as "load_mass=5" or "aircraft.mass=7".

    Raises:
        ScenarioError: the file cannot be read, or a field cannot be used.
    """
    tree: dict[str, Any] = {}
    if file is not None:
        path = Path(file)
        require(path.suffix in (".yaml", ".yml"), "REQUEST", file, "give a .yaml file")
        content = parse_plain(read_text(path, "REQUEST"), path.name)
        is_mapping = content is None or (isinstance(content, dict) and "_tag" not in content)
        require(is_mapping, path.name, content, "give a mapping of fields to values")
        tree = {"name": path.stem} | (content or {})
    for override in overrides:
        _apply(tree, override)
    request = DesignRequest()
    if "aircraft" in tree:
        request.aircraft = AircraftParameters()
        remedy = "give a mapping such as {model: rascal_110}"
        require(isinstance(tree["aircraft"], dict), "request.aircraft", tree["aircraft"], remedy)
    Walk().read("request", DesignRequest, tree, request)
    request.check()
    return request


def _apply(tree: dict[str, Any], override: str) -> None:
    path, value = parse_override(override)
    owner, dot, field = path.partition(".")
    if dot:
        require(owner == "aircraft", "--set", path, "give a field, or aircraft.FIELD")
        tree = tree.setdefault(owner, {"model": "rascal_110"})
        require(isinstance(tree, dict), "--set", path, f"{owner} has no parts; set it whole")
    tree[field or path] = value


def dump_request(request: DesignRequest) -> str:
    """The request as YAML with every field that it gives, which `read_request` reads."""
    return "".join(f"{key}: {dump_plain(value)}\n" for key, value in _tree(request).items())


def commented_request(request: DesignRequest) -> str:
    """The request as YAML with the unit and meaning of every field."""
    about = (inspect.getdoc(DesignRequest) or "").splitlines()
    lines = [*(f"# {text}".rstrip() for text in about)]
    return "\n".join([*lines, *commented_fields(0, _tree(request), DesignRequest), ""])


def _tree(request: DesignRequest) -> dict[str, Any]:
    given = {k: v for k, v in vars(request).items() if v is not None}
    return given | {"aircraft": {k: v for k, v in vars(request.aircraft).items() if v is not None}}
