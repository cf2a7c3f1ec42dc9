"""Limits of a run, beyond which it is not ok."""

from dataclasses import dataclass
from typing import Any

from drake_nonstop.validation import StrictFields, fulfilling, non_negative


def _limit(default: float | None) -> Any:
    """A field from 0 to .inf, which is no limit; or None, where that is its default."""
    remedy = "give a number that is not negative, or .inf for no limit"
    return fulfilling(default, lambda limit: limit >= 0, remedy)


@dataclass(kw_only=True)
class RunLimits(StrictFields):
    """The limits that decide a run's outcome.

    The reach is the distance of the load's farthest attachment from its centre of mass plus the
    length of a cable, both as simulated: shares of it suit cables of 0.8 m and of 60 m alike. A
    distance of 0, or another limit of .inf, limits nothing. With aircraft the load's errors have
    other default limits, since a fifth of a reach of 150 m is too much.
    """

    # Beyond one of these the outcome is not ok. The reach is the distance of the load's farthest
    # attachment from its centre of mass plus the length of a cable. A load is lost beyond
    # position_error (of the reach; left out 0.2, with aircraft 1 m), tilt_error or yaw_error (rad;
    # left out 0.8, with aircraft 0.26, which is 15 deg) from its reference.

    carrier_distance: float = non_negative(0.05)  # of the reach; two that come closer collide
    cable_distance: float = fulfilling(  # of two cables' attachments; closer cables collide
        0.05,
        lambda share: 0 <= share < 1,
        "give a share from 0 (no limit) to less than 1: cables are as close as their attachments",
    )
    clearance: float = non_negative(0.0)  # m, of load, cables and carriers from obstacles
    slack_time: float = _limit(0.0)  # s, for which a cable may be slack
    time_below_bound: float = _limit(0.0)  # s, for which a carrier may be below ε
    saturated_share: float = _limit(0.1)  # of the time, with an aircraft's command at its limit
    position_error: float | None = _limit(None)  # of the reach; default 0.2, with aircraft 1 m
    tilt_error: float | None = _limit(None)  # rad; default 0.8, with aircraft 0.26 (15 deg)
    yaw_error: float | None = _limit(None)  # rad; default 0.8, with aircraft 0.26 (15 deg)
