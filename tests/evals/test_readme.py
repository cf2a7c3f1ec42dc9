"""The claims of README and documentation hold, to the digits they print."""

import shlex
from pathlib import Path

import pytest

from drake_nonstop import load_scenario
from drake_nonstop.benchmarks.claims import QUANTITIES, documentation, read_claims

README = Path(__file__).parents[2] / "README.md"
ALL = read_claims(documentation(README))
CLAIMS = [claim for claim in ALL if claim.is_in_table]  # the others by `drake-nonstop report` only
PLAIN = [claim for claim in CLAIMS if " " not in claim.arguments]
CHANGED = sorted({claim.arguments for claim in CLAIMS} - {claim.arguments for claim in PLAIN})


def test_the_claims_were_found():
    assert len(PLAIN) >= 30
    assert len(CHANGED) >= 6
    assert len(ALL) >= len(CLAIMS) + 50


@pytest.mark.parametrize("claim", PLAIN, ids=lambda claim: f"{claim.arguments}-{claim.quantity}")
def test_claim_on_a_shipped_scenario(evaluated, claim):
    value = QUANTITIES[claim.quantity](*evaluated(claim.arguments))
    assert claim.holds(value), value


@pytest.mark.parametrize("arguments", CHANGED)
def test_claims_on_a_changed_scenario(shared_runs, arguments):
    name, *overrides = shlex.split(arguments)
    run = shared_runs.evaluated(load_scenario(name, overrides))
    for claim in CLAIMS:
        if claim.arguments == arguments:
            value = QUANTITIES[claim.quantity](*run)
            assert claim.holds(value), (claim.quantity, value)
