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
        ({"intervals": -1}, "from 8 to 200"),
        ({"intervals": 5, "knot_spacing": 0.4}, "from 8 to 200"),
        ({"intervals": 1000, "knot_spacing": 0.4}, "from 8 to 200"),
        ({"knot_spacing": 0.01}, "at least 0.0283 s"),
        ({"knot_spacing": float("nan")}, "finite"),
        ({"knot_spacing": 1e-5}, "at least 0.0001 s"),
        ({"smoothing": 0.0}, "greater than zero"),
        ({"smoothing": 1e9}, "at most 10 intervals"),
        ({"instants": 1}, "from 2 to 1333"),
        ({"instants": 2.5}, "from 2 to 1333"),
        ({"fixed_coefficients": 3}, "from 4 to 18"),
        ({"fixed_coefficients": True}, "from 4 to 18"),
    ],
)
def test_a_value_that_cannot_be_used_is_named_with_its_remedy(fields, remedy):
    name, value = next(iter(fields.items()))
    with pytest.raises(ScenarioError, match=f"layer.{name} = {re.escape(str(value))}: .*{remedy}"):
        check(**fields)


def test_the_defaults_are_accepted():
    check()
    for field in dataclasses.fields(HorizonConfig):
        check(**{field.name: field.default})
