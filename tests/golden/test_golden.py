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


@pytest.mark.parametrize("name", long_ones_nightly(flights()))
def test_a_flight_has_its_golden_numbers(name, fleet):
    found = differences(TABLE[name], numbers_of_flight(name, fleet))
    assert not found, "\n".join(found.values())


def test_there_are_golden_flights():
    assert {*TABLE} == {*flights()}
    assert len(drawn_loops()) == 40


FAULTS = [
    ("quintic", "load_state at 5.00 s"),
    ("line", "carriers.speed_min_m_s"),
    ("aircraft_transfer_gusty", "aircraft.thrust_max_N"),
    ("three_on_a_circle", "tensions at 1.33 s"),
    ("loop_5", "wrench at 1.00 s"),
]


@pytest.mark.parametrize(("name", "quantity"), FAULTS)
def test_a_fault_in_a_number_is_reported(name, quantity, fleet):
    """Twice the tolerance is enough."""
    numbers = numbers_of_flight(name, fleet)
    golden = TABLE[name][quantity]
    planted = {**TABLE[name], quantity: golden._replace(value=golden.value + 2 * golden.tolerance)}
    (sentence,) = differences(planted, numbers).values()
    assert sentence.startswith(f"{quantity} = {numbers[quantity]}: the golden one is ")


def test_a_fault_in_an_outcome_is_reported(fleet):
    numbers = numbers_of_flight("that_falls", fleet)
    planted = {**TABLE["that_falls"], "outcome": Golden("ok")}
    (sentence,) = differences(planted, numbers).values()
    assert sentence == "outcome = load_lost: the golden one is ok"


def test_numbers_that_come_and_go_are_reported():
    found = differences({"a": Golden(1.0), "b": Golden(2.0)}, {"b": 2.0, "c": 3.0})
    assert [*found.values()] == ["a: there is none any more", "c = 3.0: it is new"]


def test_a_tolerance_is_a_hundred_times_the_change_of_a_heavier_or_lighter_load():
    found = tolerances(
        {"a": 5.0, "b": 3000.0, "c": "ok"}, [{"a": 5.25, "b": 3000.0, "c": "ok"}] * 2
    )
    assert found["a"] == Golden(5.0, 25.0)
    assert found["b"] == Golden(3000.0, 3e-9)
    with pytest.raises(ValueError, match="hangs on the load's last digit"):
        tolerances({"c": "ok"}, [{"c": "collision"}])
    with pytest.raises(ValueError, match="b: it comes or goes"):
        tolerances({"a": 1.0}, [{"a": 1.0}, {"a": 1.0, "b": 2.0}])


def test_a_weighted_sum_has_each_entry_its_order_and_its_sign():
    values = [0.3, -0.2, 0.5]
    first = weighted_sum(values)
    for others in ([-0.3, -0.2, 0.5], [0.3, 0.2, 0.5], [0.3, -0.2, -0.5], [-0.2, 0.3, 0.5]):
        assert abs(weighted_sum(others) - first) > 0.05


def test_a_table_is_read_as_it_is_written(tmp_path):
    write_table(TABLE, tmp_path / "numbers.csv")
    assert read_table(tmp_path / "numbers.csv") == TABLE
