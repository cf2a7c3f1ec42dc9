"""How the 3D scene of a scenario looks: colours and sizes."""

import re
from dataclasses import dataclass, field

from drake_nonstop.validation import (
    StrictFields,
    is_number,
    require,
    require_positive,
)


@dataclass(kw_only=True)
class SceneConfig(StrictFields):
    """Colours (#rrggbb) and sizes.

    The load's radius is that of its farthest attachment from the centre of mass; the reach is
    this radius plus the length of a cable.
    """

    load_colour: str = "#30343b"
    reference_colour: str = "#8a4fff"
    reference_opacity: float = 0.2
    # The palette starts with that of Okabe and Ito, which the colour-blind can tell apart.
    carrier_colours: list[str] = field(
        default_factory=lambda: [
            *("#0072b2", "#d55e00", "#009e73", "#cc79a7"),
            *("#e69f00", "#56b4e9", "#7f5f3f", "#882255"),
        ]
    )
    mark_colours: list[str] = field(  # of a carrier at ε, between, and from mark_range ε up
        default_factory=lambda: ["#e0101a", "#f5b800", "#18a048"]
    )
    mark_range: float = 1.5  # of ε
    mark_opacity: float = 0.35
    cable_colours: list[str] = field(  # of a cable from no tension up to tension_range
        default_factory=lambda: ["#9cc4e4", "#08306b"]
    )
    tension_range: float = 2.0  # of a cable's share of the load's weight
    slack_colour: str = "#ff00c8"
    wind_colour: str = "#8c510a"
    background_colour: str = "#f7f7fa"
    wing_span: float = 0.2  # of the reach
    cable_radius: float = 0.0035  # of the reach
    bar_radius: float = 0.022  # of the load's radius, but at least two cable radii
    trail_radius: float = 0.0025  # of the reach
    trail_time: float = 10.0  # of √(reach/gravity), until a trail has faded
    trail_pieces: int = 40  # of one trail, each of constant opacity


def check_scene(config: SceneConfig) -> None:
    """Raises ScenarioError for the first field that is out of range."""
    lists = {
        name: getattr(config, name) for name in ("carrier_colours", "mark_colours", "cable_colours")
    }
    for name, least in (("carrier_colours", 1), ("mark_colours", 2), ("cable_colours", 2)):
        colours = lists[name]
        is_list = isinstance(colours, list) and len(colours) >= least
        require(is_list, f"scene.{name}", colours, f"give {least} or more of #rrggbb")
    singles = {
        name: [getattr(config, name)]
        for name in (
            "load_colour",
            "reference_colour",
            "slack_colour",
            "wind_colour",
            "background_colour",
        )
    }
    for name, colours in (lists | singles).items():
        for colour in colours:
            require(
                isinstance(colour, str) and re.fullmatch("#[0-9a-fA-F]{6}", colour),
                f"scene.{name}",
                colour,
                "give a colour as #rrggbb, such as #0072b2",
            )
    require_positive(
        "scene",
        wing_span=config.wing_span,
        cable_radius=config.cable_radius,
        bar_radius=config.bar_radius,
        trail_radius=config.trail_radius,
        trail_time=config.trail_time,
        tension_range=config.tension_range,
    )
    for name in ("mark_opacity", "reference_opacity"):
        opacity = getattr(config, name)
        is_share = is_number(opacity) and 0 <= opacity <= 1
        require(is_share, f"scene.{name}", opacity, "give a number from 0 to 1")
    require(
        is_number(config.mark_range) and config.mark_range > 1,
        "scene.mark_range",
        config.mark_range,
        "give a number greater than 1",
    )
    require(
        isinstance(config.trail_pieces, int) and 2 <= config.trail_pieces <= 1000,
        "scene.trail_pieces",
        config.trail_pieces,
        "give a whole number from 2 to 1000",
    )
