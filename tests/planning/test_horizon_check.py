import dataclasses
import re

import pytest
from helpers import model

from drake_nonstop.planning.horizon_config import HorizonConfig, check_horizon
from drake_nonstop.planning.problem_config import LimitsConfig
from drake_nonstop.validation import ScenarioError

LIMITS = LimitsConfig(frequency=2.0)  # a turn takes 3.1416 s


def check(control_period=0.0, **fields):
    config = HorizonConfig(**fields)
    check_horizon("layer", config, LIMITS, model(control_period=control_period))


@pytest.mark.parametrize(
    ("fields", "remedy"),
    [
        ({"horizon": -1.0}, "not negative"),
        ({"horizon": 2.0, "knot_spacing": 0.4}, "shorter than a turn.* at least 3.2 s"),
        ({"horizon": 6.1, "knot_spacing": 0.4}, "a multiple of the 0.4 s .* such as 6.4"),
        ({"horizon": 400.0, "knot_spacing": 0.4}, "1000 intervals .* at most 200 of them, 80 s"),
        ({"horizon": 1e9, "knot_spacing": 0.39}, "intervals .* at most 200 of them, 78 s"),
        ({"horizon": 0.0, "knot_spacing": 0.01}, "566 .* layer.knot_spacing of at least 0.0283 s"),
        ({"knot_spacing": float("nan")}, "finite"),
        ({"knot_spacing": 1e-5}, "at least 0.0001 s"),
        ({"smoothing": 0.0}, "greater than zero"),
        ({"smoothing": 1e9}, "at most 10 intervals"),
        ({"slack_weight": 0.0}, "greater than zero"),
        ({"amplitude_weight": -1.0}, "greater than zero"),
        ({"instants": 1}, "from 2 to 1333"),
        ({"instants": 2.5}, "from 2 to 1333"),
        ({"terminal_knots": 16}, "from 1 to 15"),
        ({"terminal_knots": 0}, "from 1 to 15"),
        ({"terminal_instants": 21}, "from 1 to 20"),
        ({"terminal_phases": 4}, "from 8 to 360"),
        ({"fixed_coefficients": 3}, "from 4 to 18"),
        ({"fixed_coefficients": True}, "from 4 to 18"),
    ],
)
def test_a_value_that_cannot_be_used_is_named_with_its_remedy(fields, remedy):
    name, value = next(iter(fields.items()))
    with pytest.raises(ScenarioError, match=f"layer.{name} = {re.escape(str(value))}: .*{remedy}"):
        check(**fields)


def test_knots_are_multiples_of_the_control_period():
    with pytest.raises(ScenarioError, match=r"layer.knot_spacing = 0.394: .* 0.004, such as 0.392"):
        check(control_period=0.004, knot_spacing=0.394, horizon=3.94)
    check(control_period=0.004, knot_spacing=0.392)
    check(control_period=0.004)


@pytest.mark.parametrize("spacing", [0.3, 0.392, 0.4, 0.7])
def test_a_horizon_that_is_told_as_the_least_is_accepted(spacing):
    with pytest.raises(ScenarioError) as error:
        check(horizon=1.0, knot_spacing=spacing)
    least = float(re.search("at least ([0-9.]+) s", str(error.value))[1])
    check(horizon=least, knot_spacing=spacing, terminal_knots=1)
    with pytest.raises(ScenarioError, match="horizon"):
        check(horizon=least - spacing, knot_spacing=spacing, terminal_knots=1)


def test_knots_that_are_told_as_far_enough_apart_are_accepted():
    for horizon in (0.0, 4.0):
        with pytest.raises(ScenarioError) as error:
            check(horizon=horizon, knot_spacing=0.005)
        least = float(re.search("knot_spacing of at least ([0-9.]+) s", str(error.value))[1])
        check(horizon=horizon, knot_spacing=least)


def test_the_defaults_are_accepted():
    check()
    for field in dataclasses.fields(HorizonConfig):
        check(**{field.name: field.default})
