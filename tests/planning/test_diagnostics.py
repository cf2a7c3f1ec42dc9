import numpy as np
import pytest

from drake_nonstop.planning.diagnostics import (
    Diagnostics,
    Outcome,
    count_update,
)


@pytest.mark.parametrize("outcome", [outcome for outcome in Outcome if outcome != Outcome.NONE])
def test_an_update_is_counted_under_its_outcome(outcome):
    vector = np.array([Outcome.KEPT, 10.0, 4.0, 3.0, 2.0, 1.0, 0.3])
    before = Diagnostics.view(vector.copy())
    assert before.updates == 10
    count_update(vector, outcome, 0.1)
    after = Diagnostics.view(vector)
    counts = {outcome.name.lower(): getattr(before, outcome.name.lower()) + 1}
    expected = before._replace(outcome=outcome, updates=11, speed_margin=0.1, **counts)
    np.testing.assert_array_equal(after, expected)
