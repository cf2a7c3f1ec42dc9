"""How the 3D scene of a scenario looks: colours and sizes."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drake_nonstop.validation import StrictFields, checked, fulfilling, positive, require, whole


def _check_colour(field: str, value: Any) -> None:
    is_colour = isinstance(value, str) and re.fullmatch("#[0-9a-fA-F]{6}", value)
    require(is_colour, field, value, "give a colour as #rrggbb, such as #0072b2")


def _colour(default: str) -> Any:
    return checked(default, _check_colour)


def _colours(least: int) -> Callable[[str, Any], None]:
    """The check of a field of that many colours or more."""

    def check(field: str, value: Any) -> None:
        is_list = isinstance(value, list) and len(value) >= least
        require(is_list, field, value, f"give {least} or more of #rrggbb")
        for colour in value:
            _check_colour(field, colour)

    return check


def _share(default: float) -> Any:
    return fulfilling(default, lambda share: 0 <= share <= 1, "give a number from 0 to 1")


@dataclass(kw_only=True)
class SceneConfig(StrictFields):
    """Colours (#rrggbb) and sizes.

    The load's radius is that of its farthest attachment from the centre of mass; the reach is
    this radius plus the length of a cable.
    """

    load_colour: str = _colour("#30343b")
    reference_colour: str = _colour("#8a4fff")
    reference_opacity: float = _share(0.2)
    # The palette starts with that of Okabe and Ito, which the colour-blind can tell apart.
    carrier_colours: list[str] = checked(
        ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f5f3f", "#882255"],
        _colours(1),
    )
    mark_colours: list[str] = checked(  # of a carrier at ε, between, and from mark_range ε up
        ["#e0101a", "#f5b800", "#18a048"], _colours(2)
    )
    mark_range: float = fulfilling(  # of ε
        1.5, lambda share: 1 < share < float("inf"), "give a number greater than 1"
    )
    mark_opacity: float = _share(0.35)
    cable_colours: list[str] = checked(  # of a cable from no tension up to tension_range
        ["#9cc4e4", "#08306b"], _colours(2)
    )
    tension_range: float = positive(2.0)  # of a cable's share of the load's weight
    slack_colour: str = _colour("#ff00c8")
    wind_colour: str = _colour("#8c510a")
    obstacle_colour: str = _colour("#a08c72")
    obstacle_opacity: float = _share(0.6)
    background_colour: str = _colour("#f7f7fa")
    wing_span: float = positive(0.2)  # of the reach
    cable_radius: float = positive(0.0035)  # of the reach
    bar_radius: float = positive(0.022)  # of the load's radius, but at least two cable radii
    trail_radius: float = positive(0.0025)  # of the reach
    trail_time: float = positive(10.0)  # of √(reach/gravity), until a trail has faded
    trail_pieces: int = whole(40, 2, 1000)  # of one trail, each of constant opacity
