"""The README's table of numbers holds what the runs give, to the digits it prints."""

import re
from pathlib import Path

import numpy as np
import pytest

from drake_nonstop.metrics import carrier_speeds

README = Path(__file__).parents[2] / "README.md"
ROWS = re.findall(
    r"^\| `(\w+)` \| ([^|]+) \|[^|]*\| ([\d.]+) \|$",
    README.read_text(encoding="utf-8"),
    re.MULTILINE,
)


def first_near_the_bound(run, metrics):
    time, speeds = run.steps["time"], carrier_speeds(run.steps["carrier_state"]).min(axis=1)
    near = (speeds <= 1.03 * metrics["carriers"]["speed_bound_m_s"]) & (time >= 1)
    return time[np.flatnonzero(near)[0]]


def slowest_while_moving(run, metrics):
    time, speeds = run.steps["time"], carrier_speeds(run.steps["carrier_state"]).min(axis=1)
    return speeds[(time > 7) & (time < 23)].min()


MEASURED = {
    "first within 3 % of the bound (s)": first_near_the_bound,
    "slowest while moving (m/s)": slowest_while_moving,
    "slowest (m/s)": lambda run, metrics: metrics["carriers"]["speed_min_m_s"],
    "peak speed (m/s)": lambda run, metrics: metrics["carriers"]["speed_max_m_s"],
    "slowest final speed (m/s)": lambda run, metrics: min(metrics["carriers"]["speed_final_m_s"]),
    "fastest final speed (m/s)": lambda run, metrics: max(metrics["carriers"]["speed_final_m_s"]),
    "time below the bound (s)": lambda run, metrics: metrics["carriers"]["time_below_bound_s"],
    "mean position error (mm)": lambda run, metrics: 1e3 * metrics["load"]["position_error_mean_m"],
    "final A (N)": lambda run, metrics: metrics["optimizer"]["A_final_N"],
    "final ξ (rad/s)": lambda run, metrics: metrics["optimizer"]["xi_final_rad_s"],
}


def test_the_table_was_found():
    assert len(ROWS) >= 20


@pytest.mark.parametrize(("scenario", "quantity", "printed"), ROWS)
def test_row(evaluated, scenario, quantity, printed):
    value = MEASURED[quantity](*evaluated(scenario))
    digits = len(printed.partition(".")[2])
    assert abs(value - float(printed)) <= 1.05 * 10**-digits
