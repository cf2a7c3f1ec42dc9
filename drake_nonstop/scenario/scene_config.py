"""How the 3D scene of a scenario looks."""

from dataclasses import dataclass

from drake_nonstop.validation import StrictFields, positive


@dataclass(kw_only=True)
class SceneConfig(StrictFields):
    """Sizes of what is drawn.

    The reach is the distance of the load's farthest attachment from its centre of mass, plus the
    length of a cable.
    """

    wing_span: float = positive(0.2)  # of the reach
    trail_time: float = positive(10.0)  # of √(reach/gravity), until a trail has faded
