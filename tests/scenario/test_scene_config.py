"""The checks of a scene's colours and sizes."""

import pytest

from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import ScenarioError, require_ranges


def test_the_default_is_valid():
    require_ranges("scene", SceneConfig())


@pytest.mark.parametrize(
    ("field", "value", "remedy"),
    [
        ("load_colour", "blue", "#rrggbb"),
        ("mark_colours", ["#000000"], "2 or more"),
        ("carrier_colours", [], "1 or more"),
        ("cable_colours", ["#000000", "12"], "#rrggbb"),
        ("wing_span", 0.0, "greater than zero"),
        ("trail_time", float("nan"), "greater than zero"),
        ("mark_range", 1.0, "greater than 1"),
        ("mark_opacity", -0.1, "from 0 to 1"),
        ("reference_opacity", 1.1, "from 0 to 1"),
        ("carrier_colours", 5, "1 or more"),
        ("trail_pieces", 1, "2 to 1000"),
    ],
)
def test_bad_config_tells_field_value_and_remedy(field, value, remedy):
    with pytest.raises(ScenarioError, match=f"^scene\\.{field} = .*{remedy}"):
        require_ranges("scene", SceneConfig(**{field: value}))
