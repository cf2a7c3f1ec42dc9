"""What a run is held against: beyond which figures it is not ok, or not plausible."""

import math
from dataclasses import dataclass

from drake_nonstop.validation import StrictFields, is_number, require, require_non_negative


@dataclass(kw_only=True)
class RunLimits(StrictFields):
    """The limits that decide a run's outcome, and those that it is warned about.

    The reach is the distance of the load's farthest attachment from its centre of mass plus the
    length of a cable, both as simulated; shares of it suit cables of 0.8 m and of 60 m alike. The
    weight is that of the simulated load. There is no limit where a distance is 0, or another .inf.
    Where the carriers are aircraft the load's errors have other default limits: a fifth of a reach
    of 150 m is no transport.
    """

    # Beyond one of these the outcome is not ok. The reach is the distance of the load's farthest
    # attachment from its centre of mass plus the length of a cable. A load is lost beyond
    # position_error (of the reach; left out 0.2, with aircraft 1 m) and orientation_error (rad;
    # left out 0.8, with aircraft 0.26, which is 15 deg) from its reference.

    carrier_distance: float = 0.05  # of the reach; two carriers that come closer collide
    cable_distance: float = 0.05  # of two cables' attachments; cables that come closer collide
    slack_time: float = 0.0  # s, for which a cable may be slack
    time_below_bound: float = 0.0  # s, for which a carrier may be below ε
    saturated_share: float = 0.1  # of the time with a command of an aircraft at its limit
    position_error: float | None = None  # of the reach; default 0.2, with aircraft 1 m
    orientation_error: float | None = None  # rad; default 0.8, with aircraft 0.26 (15 deg)

    # Beyond one of these the model is not plausible, which is warned about.

    speed: float = 100.0  # m/s, of a carrier
    acceleration: float = 100.0  # m/s², of a carrier
    tension: float = 5.0  # of the load's weight, of one cable


def check_limits(limits: RunLimits) -> None:
    """Raises ScenarioError for the first limit that cannot be one."""
    for name, value in vars(limits).items():
        has_default = name in ("position_error", "orientation_error") and value is None
        if not (name.endswith("_distance") or has_default):
            require(
                (is_number(value) and value >= 0) or value == math.inf,
                f"limits.{name}",
                value,
                "give a number that is not negative, or .inf for no limit",
            )
    require_non_negative("limits", carrier_distance=limits.carrier_distance)
    require(
        is_number(limits.cable_distance) and 0 <= limits.cable_distance < 1,
        "limits.cable_distance",
        limits.cable_distance,
        "give a share from 0 (no limit) to less than 1: cables are as close as their attachments",
    )
