"""The claims of README and documentation hold, to the digits they print."""

import shlex
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks.claims import documentation, measure, read_claims
from benchmarks.measures import MEASURES, RUN

from drake_nonstop import compute_metrics, load_scenario, scenario_names
from drake_nonstop.run.simulate import simulate

QUANTITIES = MEASURES[RUN].quantities
README = Path(__file__).parents[2] / "README.md"
TEXT = documentation(README)
ALL = read_claims(TEXT)
BY_ARGUMENTS = defaultdict(list)
for claim in ALL:
    if not claim.is_of_speed:
        BY_ARGUMENTS[claim.arguments].append(claim)
SHIPPED = [arguments for arguments in BY_ARGUMENTS if arguments in scenario_names()]
CHANGED = [arguments for arguments in BY_ARGUMENTS if arguments not in SHIPPED]
# One that flies fast.
CHEAP = "line optimization_layer=NlpLayer"


def test_the_claims_were_found():
    in_table = [claim for claim in ALL if claim.is_in_table]
    assert len([claim for claim in in_table if claim.arguments in SHIPPED]) >= 30
    assert len(CHANGED) >= 30
    assert len(ALL) >= len(in_table) + 50


@pytest.mark.parametrize("name", SHIPPED)
def test_claims_on_a_shipped_scenario(evaluated, name):
    """In tables and paragraphs."""
    assert_hold(BY_ARGUMENTS[name], *evaluated(name))


@pytest.mark.parametrize("shift", [-2, 2])
def test_a_fault_in_a_claim_is_reported(evaluated, shift):
    """Two of the last digit, in the text."""
    quantity = "slowest speed (m/s)"
    true = next(claim for claim in BY_ARGUMENTS["quintic"] if claim.quantity == quantity)
    digits = len(true.printed.partition(".")[2])
    planted = f"{float(true.printed) + shift * 10**-digits:.{digits}f}"
    claims = read_claims(TEXT.replace(true.printed, planted))
    (found,) = [
        claim for claim in claims if replace(claim, printed="") == replace(true, printed="")
    ]
    value = QUANTITIES[quantity](evaluated("quintic"))
    assert true.fault(value) == ""
    assert found.fault(value).endswith(f"not {planted}")


def assert_hold(claims, run, metrics):
    assert claims
    for claim in claims:
        value = QUANTITIES[claim.quantity]((run, metrics))
        assert claim.holds(value), (claim.quantity, value)


@pytest.mark.nightly("flights")
def test_claims_on_a_changed_scenario():
    name, *overrides = shlex.split(CHEAP)
    run = simulate(load_scenario(name, overrides))
    assert_hold(BY_ARGUMENTS[CHEAP], run, compute_metrics(run))


@pytest.mark.nightly("flights")
def test_claims_on_changed_scenarios():
    """Those of tables; those of paragraphs are measured by `python -m tests.benchmarks report`."""
    of_changed = [claim for arguments in CHANGED for claim in BY_ARGUMENTS[arguments]]
    claims = [claim for claim in of_changed if claim.is_in_table]
    assert len(claims) >= 12
    assert [fault for claim, value in measure(claims) if (fault := claim.fault(value))] == []
