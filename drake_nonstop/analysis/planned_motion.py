"""Where carriers and cables are along a task's plan, and how the cables pull there."""

import contextlib
import dataclasses
import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.carriers_along import carriers_along
from drake_nonstop.analysis.limit import find_collisions
from drake_nonstop.analysis.separations import Spacing, closest_cables, closest_carriers
from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.model.pattern import SpreadCarouselConfig
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.planning.carriers import motion_above, orbit_terms
from drake_nonstop.planning.plan import Plan
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError

_SPREADS = (1.2, 2.0, 3.0)  # of the nominal A
_AMPLITUDES = (0.8, 0.6, 0.4)  # likewise
_LIFTS = tuple(1.01 * 2**k for k in range(8))  # of what is missing of the clearance
_LEVEL = -0.02  # of an equal share of the weight, of a cable that is nearly level
_PER_TURN = 64  # instants: between them an arc is 1/800 of its radius from its chord


class LeastLoad(NamedTuple):
    """The cable that carries least of the weight along a plan."""

    time: float  # s
    cable: int  # from 1 on
    share: float  # of an equal share of the weight; negative: the cable would have to push
    elevation: float  # rad, of its force on the load above the horizontal
    tension: float  # N

    @property
    def pulls_up(self) -> bool:
        """Whether the cable pulls at the load, and need not push."""
        return self.share > 0

    @property
    def is_in_doubt(self) -> bool:
        """Whether it does not by so little that a flight alone tells whether it gets slack."""
        return _LEVEL < self.share <= 0

    @property
    def text(self) -> str:
        """Which cable it is, when, and how it pulls."""
        side = "above" if self.elevation > 0 else "below"
        return (
            f"cable {self.cable} carries {self.share:.2g} of an equal share of the weight at "
            f"t = {self.time:.2f} s, {abs(math.degrees(self.elevation)):.1f} deg {side} the "
            f"horizontal with {self.tension:.3g} N"
        )


class PlannedMotion(Spacing):
    """The motion of a task's carriers that follow its plan exactly, with the simulated masses.

    Args:
        scenario: of the task.
        task: what is flown.
        plan: of ξ and A; None: the nominal ones are flown.
    """

    def __init__(self, scenario: Scenario, task: Task, plan: Plan | None = None):
        self.scenario, self._model = scenario, task.flown
        fastest = task.limits.frequency * (1 if plan is None else plan.coefficients[0].max())
        turns = task.duration * fastest / (2 * math.pi)
        self.time = times = np.linspace(0, task.duration, math.ceil(_PER_TURN * (1 + turns)))
        planned = task.planned(plan, times)
        references = np.array([task.reference(time) for time in times])
        terms = orbit_terms(task.flown, references, [task.wind_at(time) for time in times])
        motion = motion_above(task.flown, terms, planned)
        self._forces = motion.forces
        self.load_positions = LoadReference.view(references).position
        self._attachments = terms.motion.attached(self._model.attachments).rates[0]
        has_bow = task.response.references.shape is not None
        bowed = carriers_along(task, times).bowed(planned, motion) if has_bow else None
        nodes: Any = [] if bowed is None else bowed.nodes
        self._carriers = (motion if bowed is None else bowed.motion).positions
        self._points = np.stack([self._attachments, *nodes, self._carriers])

    @property
    def system(self) -> SystemParameters:
        """The simulated load, cables and carriers."""
        return self._model.system

    @property
    def attachment_positions(self) -> NDArray:
        """Where the cables are attached to the load, (k, n, 3), in W, m."""
        return self._attachments

    @property
    def carrier_positions(self) -> NDArray:
        """(k, n, 3), in W, m."""
        return self._carriers

    @property
    def cable_points(self) -> NDArray:
        """Those of bowed cables, where references know of them."""
        return self._points

    @cached_property
    def collisions(self) -> list[str]:
        """Collisions, see `find_collisions`."""
        return find_collisions(self)

    @property
    def is_flyable(self) -> bool:
        """Whether nothing collides, and all cables pull."""
        return not self.collisions and self.least_load.pulls_up

    @cached_property
    def least_load(self) -> LeastLoad:
        """That of all cables, at any time."""
        vertical = self._forces[..., 2]
        instant, cable = np.unravel_index(np.argmin(vertical), vertical.shape)
        force, model = self._forces[instant, cable], self._model
        return LeastLoad(
            time=float(self.time[instant]),
            cable=int(cable) + 1,
            share=float(force[2] * model.n / (model.load_mass * model.gravity)),
            elevation=math.atan2(force[2], math.hypot(*force[:2])),
            tension=float(np.linalg.norm(force)),
        )

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Of a table: quantity, value, where."""
        between, apart = self.closest_cables_for_attachments
        ends, carriers = self.attachment_positions, self.carrier_positions
        of_carriers, of_cables = (
            f"t = {self.time[np.argmin(distances)]:.2f} s"
            for distances in (closest_carriers(carriers), closest_cables(ends, carriers))
        )
        return [
            ("least distance of two carriers", f"{self.carrier_separation:.3g} m", of_carriers),
            (
                "least distance of two cables",
                f"{between:.3g} m",
                f"{of_cables}, attached {apart:.3g} m apart",
            ),
            *(
                (
                    f"least distance of {each.obstacle} from {each.body}",
                    f"{each.distance:.3g} m",
                    f"t = {each.time:.2f} s",
                )
                for each in self.approaches
            ),
        ]

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file; keys end in their units."""
        between, attachments = self.closest_cables_for_attachments
        least = self.least_load
        return {
            "are_apart": not self.collisions,
            "collisions": self.collisions,
            "carriers_min_m": self.carrier_separation,
            "cables_min_m": between,
            "obstacles": [approach._asdict() for approach in self.approaches],
            "attachments_of_these_cables_m": attachments,
            "least_share": least.share,
            "least_share_at_s": least.time,
            "least_share_cable": least.cable,
            "least_share_elevation_rad": least.elevation,
            "least_share_tension_N": least.tension,
        }


def find_motion_remedies(scenario: Scenario, task: Task) -> list[str]:
    """Remedies that keep all apart and clear of obstacles with nominal ξ and A, each tried.

    That is a path so much higher, where an obstacle is too near, and else carriers that circle
    beside each other, and a smaller A.
    """
    distance = PlannedMotion(scenario, task).obstacle_distance()
    missing = 0.0 if distance is None else scenario.limits.clearance - distance
    for lift in (float(f"{factor * missing:.3g}") for factor in _LIFTS if missing > 0):
        if PlannedMotion(scenario, task.lifted(lift)).is_flyable:
            return [f"a load_trajectory that is {lift:g} m higher all the way"]
    remedies = []
    for factor in _SPREADS:
        config = SpreadCarouselConfig(spread=float(f"{factor * task.limits.amplitude:.3g}"))
        with contextlib.suppress(ScenarioError):  # a formation that cannot be
            if PlannedMotion(scenario, task.changed(config)).is_flyable:
                remedies.append(f"pattern=!SpreadCarousel {{spread: {config.spread:g}}}")
                break
    for factor in _AMPLITUDES:
        amplitude = float(f"{factor * task.limits.amplitude:.3g}")
        limits = dataclasses.replace(task.limits, amplitude=amplitude)
        if PlannedMotion(scenario, dataclasses.replace(task, limits=limits)).is_flyable:
            remedies.append(f"optimization_layer.amplitude={amplitude:g}")
            break
    return remedies
