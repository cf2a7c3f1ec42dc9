"""Colours of the scene, and shades between them."""

import numpy as np

Colour = tuple[float, float, float]  # red, green and blue, from 0 to 1

SHADES = 33  # in which marks and cables change their colour


def rgb(colour: str) -> Colour:
    """The colour that is written as #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red / 255, green / 255, blue / 255


def make_shades(colours: list[str]) -> list[Colour]:
    """`SHADES` colours, linearly interpolated between those given as #rrggbb."""
    stops = np.linspace(0, 1, len(colours))
    channels = np.transpose([rgb(colour) for colour in colours])
    mixed = [np.interp(np.linspace(0, 1, SHADES), stops, channel) for channel in channels]
    return [tuple(shade) for shade in np.transpose(mixed).tolist()]


def pick_shade(shades: list[Colour], share: float) -> Colour:
    """The shade at a share of the range: the first at 0, below and at NaN, the last from 1 up."""
    return shades[round(min(max(0.0, share), 1.0) * (SHADES - 1))]
