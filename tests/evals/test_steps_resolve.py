"""Some of the drawn scenarios whose metrics must not move with the step in silence.

`python -m tests.plausible_scenarios --count 300` flies all of them.
"""

import pytest
from plausible_scenarios import fly

# A short run of each kind: unstable, shortened, verified and moved, refused, resolved.
SEEDS = [318, 224, 223, 254, 310, 349, 339, 110, 271]
SAID = {318: "do not show whether the loop is stable", 224: "steps of 0.00333 s are taken"}


@pytest.mark.nightly("studies")
@pytest.mark.parametrize("seed", SEEDS)
def test_no_metric_moves_in_silence(seed):
    flight = fly(seed, is_judged_if_said=False)
    assert flight.said or not flight.moves, flight.overrides
    assert SAID.get(seed, "") in " ".join(flight.said)
