import numpy as np
import pytest

from drake_nonstop.optimization.diagnostics import DIAGNOSTICS_SIZE, Diagnostics, Outcome


@pytest.mark.parametrize("outcome", [outcome for outcome in Outcome if outcome != Outcome.NONE])
def test_an_update_is_counted_under_its_outcome(outcome):
    before = Diagnostics.view(np.array([Outcome.KEPT, 10.0, 4.0, 3.0, 2.0, 1.0, 0.3]))
    after = before.after(outcome, 0.1)
    expected = [outcome, 11, 4, 3, 2, 1, 0.1]
    expected[1 + outcome] += 1
    np.testing.assert_array_equal(after, expected)
    assert getattr(after, outcome.name.lower()) == getattr(before, outcome.name.lower()) + 1


def test_a_log_has_its_entries_over_time():
    log = np.arange(3.0 * DIAGNOSTICS_SIZE).reshape(3, DIAGNOSTICS_SIZE)
    diagnostics = Diagnostics.view(log)
    np.testing.assert_array_equal(diagnostics.updates, log[:, 1])
    np.testing.assert_array_equal(np.stack(diagnostics, axis=-1), log)
