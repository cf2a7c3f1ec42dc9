"""The claims of README and documentation hold, to the digits they print; false ones are found."""

from collections import defaultdict

import pytest
from fleet import long_ones_nightly

from benchmarks.claims import Claim, documentation, measure, read_claims, values_of
from benchmarks.measures import MEASURES, RUN
from drake_nonstop import scenario_names

TEXT = documentation()
ALL = read_claims(TEXT)
BY_ARGUMENTS = defaultdict(list)
for claim in ALL:
    if not claim.is_of_speed:
        BY_ARGUMENTS[claim.arguments].append(claim)
SHIPPED = [arguments for arguments in BY_ARGUMENTS if arguments in scenario_names()]
CHANGED = [arguments for arguments in BY_ARGUMENTS if arguments not in SHIPPED]
ROW = "| `{}` | {} | | {} |"


def test_the_claims_were_found():
    in_table = [claim for claim in ALL if claim.is_in_table]
    assert len([claim for claim in in_table if claim.arguments in SHIPPED]) >= 30
    assert len(CHANGED) >= 30
    assert len(ALL) >= len(in_table) + 50


@pytest.mark.parametrize("name", long_ones_nightly(SHIPPED))
def test_claims_on_a_shipped_scenario(fleet, name):
    """In tables and paragraphs."""
    found = fleet.evaluated(name)
    values = [MEASURES[RUN].quantities[claim.quantity](found) for claim in BY_ARGUMENTS[name]]
    assert not [*filter(None, map(Claim.fault, BY_ARGUMENTS[name], values))]


@pytest.mark.nightly("flights")
def test_claims_on_changed_scenarios():
    """Those of tables; those of paragraphs are measured by `python -m tests.benchmarks report`."""
    claims = [c for arguments in CHANGED for c in BY_ARGUMENTS[arguments] if c.is_in_table]
    assert len(claims) >= 12
    assert not [fault for claim, value in measure(claims) if (fault := claim.fault(value))]


@pytest.mark.parametrize("shift", [-2, 2])
def test_a_fault_in_a_claim_is_reported(fleet, shift):
    """Two of the last digit, in the text."""
    quantity = "slowest speed (m/s)"
    true = next(claim for claim in BY_ARGUMENTS["quintic"] if claim.quantity == quantity)
    digits = len(true.printed.partition(".")[2])
    planted = true._replace(printed=f"{float(true.printed) + shift * 10**-digits:.{digits}f}")
    assert planted in read_claims(TEXT.replace(true.printed, planted.printed))
    value = MEASURES[RUN].quantities[quantity](fleet.evaluated("quintic"))
    assert true.holds(value)
    assert planted.fault(value).endswith(f"not {planted.printed}")


@pytest.mark.parametrize(
    ("printed", "holding", "failing"),
    [
        ("0", [0.0], [0.005]),
        ("0.555", [0.5554], [0.5562]),
        ("12", [12.4], [12.7]),
        ("0.92–0.93", [0.916], [0.914, 0.936]),
        ("≤ 1.1", [-3.0], [1.16]),
        ("9.8", [5, 19], [4.8, 20]),  # of speed, within a factor of 2
    ],
)
def test_a_claim_holds_where_the_value_rounds_to_it(printed, holding, failing):
    of_speed = "engines quintic", "times the diagram"
    claim = Claim(*(of_speed if printed == "9.8" else ("line", "slowest speed (m/s)")), printed)
    assert all(claim.holds(value) for value in holding)
    assert not any(claim.holds(value) for value in failing)


PARAGRAPH = "- A first of 0.7 m/s.\n- The carriers end at 0.92–0.93 m/s,\n  whatever.\n"
PARAGRAPH += "<!-- measured\n{}\n-->\n- Another of 0.5 m/s."


def test_numbers_of_a_paragraph_are_claims_of_the_comment_below_it():
    def found_in(printed):
        row = ROW.format("line", "slowest final speed (m/s)", printed)
        return read_claims(PARAGRAPH.replace("{}", row))

    (claim,) = found_in("0.92–0.93")
    assert claim == Claim("line", "slowest final speed (m/s)", "0.92–0.93", is_in_table=False)
    for elsewhere in ("0.7", "0.5", "0.92–0.94", "≤ 0.9"):
        with pytest.raises(ValueError, match="print in the paragraph above"):
            found_in(elsewhere)


def test_rows_that_cannot_be_read_are_no_silent_gap():
    for row in (
        ("line", "slowest speed (m/s)", "about 0.2"),
        ("line", "tallest (m)", "0.2"),
        ("stability line", "final A (N)", "0.2"),
    ):
        with pytest.raises(ValueError, match="give"):
            read_claims(ROW.format(*row))


SHORT_MOVE = "load_trajectory.move_time=4 simulation_duration=5"
BRIEF = "simulation_duration=0.1 optimization_layer=ConstantParameters"


@pytest.mark.nightly("benchmarks")
@pytest.mark.parametrize(
    ("arguments", "quantity", "least", "most"),
    [
        ("stability quintic", "growth in a turn", 0, 1.001),
        (f"accuracy line {BRIEF}", "error of the load (mm)", 1e-9, 1e-3),
        (f"engines line {BRIEF}", "times the diagram", 0.5, 100),
        (f"viewer line {BRIEF}", "share of real time (%)", -50, 200),
        (f"plans quintic {SHORT_MOVE}", "cost above the best plan (%)", -0.1, 10),
    ],
)
def test_every_measure_finds_its_quantities(arguments, quantity, least, most):
    quantities = [*MEASURES[arguments.split()[0]].quantities]
    values = values_of([Claim(arguments, each, "1") for each in quantities])
    assert least < values[quantities.index(quantity)] < most
