"""Flights have their golden numbers; a change of any is found."""

import pytest
from fleet import long_ones_nightly

from golden.numbers import (
    Golden,
    differences,
    drawn_loops,
    flights,
    numbers_of_flight,
    read_table,
    tolerances,
    weighted_sum,
    write_table,
)

TABLE = read_table()


@pytest.mark.parametrize("name", long_ones_nightly(flights(), [*drawn_loops()][20:]))
def test_a_flight_has_its_golden_numbers(name, fleet):
    found = differences(TABLE[name], numbers_of_flight(name, fleet))
    assert not found, "\n".join(found.values())


def test_there_are_golden_flights():
    assert {*TABLE} == {*flights()}
    assert len(drawn_loops()) == 40


def test_numbers_that_differ_come_and_go_are_reported():
    """Twice the tolerance is enough, half of it is not."""
    golden = {"a": Golden(1.0, 0.1), "b": Golden(2.0), "c": Golden(3.0, 0.2), "d": Golden("ok")}
    numbers = {"a": 1.05, "c": 3.4, "d": "collision", "e": 5.0}
    assert [*differences(golden, numbers).values()] == [
        "b: there is none any more",
        "c = 3.4: the golden one is 3.0 (tolerance 2.0e-01)",
        "d = collision: the golden one is ok",
        "e = 5.0: it is new",
    ]


def test_a_tolerance_is_a_hundred_times_the_change_of_a_heavier_or_lighter_load():
    numbers, moved = {"a": 5.0, "b": 3e3, "c": "ok"}, {"a": 5.25, "b": 3e3, "c": "ok"}
    expected = {"a": Golden(5.0, 25.0), "b": Golden(3e3, 3e-9), "c": Golden("ok")}
    assert tolerances(numbers, [numbers, moved]) == expected
    for other in ({**moved, "c": "collision"}, {**moved, "d": 1.0}, {"a": 5.0, "c": "ok"}):
        with pytest.raises(ValueError, match="hangs on the load's last digit"):
            tolerances(numbers, [moved, other])


def test_a_weighted_sum_has_each_entry_its_order_and_its_sign():
    sums = [
        weighted_sum([a, b, c])
        for a, b, c in ((3, -2, 5), (-3, -2, 5), (3, 2, 5), (3, -2, -5), (-2, 3, 5))
    ]
    assert min(abs(other - sums[0]) for other in sums[1:]) > 0.5


def test_a_table_is_read_as_it_is_written(tmp_path):
    write_table(TABLE, tmp_path / "numbers.csv")
    assert read_table(tmp_path / "numbers.csv") == TABLE
