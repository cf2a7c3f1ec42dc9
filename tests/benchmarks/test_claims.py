"""The pages' numbers, measured anew: what holds and what does not."""

import pytest

from benchmarks import claims
from benchmarks.__main__ import main
from benchmarks.claims import Claim, read_claims, values_of
from benchmarks.measures import MEASURES
from drake_nonstop.validation import ScenarioError

BRIEF = "simulation_duration=0.1 optimization_layer=ConstantParameters"
RUN = f"quintic {BRIEF}"
ROW = "| `{}` | {} | | {} |"


@pytest.mark.parametrize(
    ("printed", "value", "holds"),
    [
        ("0", 0.0, True),
        ("0", 0.005, False),
        ("0.555", 0.5554, True),
        ("0.555", 0.5562, False),
        ("12", 12.4, True),
        ("12", 12.7, False),
        ("0.92–0.93", 0.916, True),
        ("0.92–0.93", 0.914, False),
        ("0.92–0.93", 0.936, False),
        ("≤ 1.1", -3.0, True),
        ("≤ 1.1", 1.16, False),
    ],
)
def test_a_claim_holds_where_the_value_rounds_to_it(printed, value, holds):
    claim = Claim(arguments="line", quantity="slowest speed (m/s)", printed=printed)
    assert claim.holds(value) == holds


@pytest.mark.parametrize(("value", "holds"), [(5, True), (19, True), (4.8, False), (20, False)])
def test_a_claim_of_speed_holds_within_a_factor(value, holds):
    claim = Claim(arguments="engines quintic", quantity="times the diagram", printed="9.8")
    assert claim.holds(value) == holds


def test_rows_that_cannot_be_read_are_no_silent_gap():
    text = ROW.format("line", "slowest speed (m/s)", "0.2")
    assert len(read_claims(text)) == 1
    with pytest.raises(ScenarioError, match=r"claim = .*with ours a number"):
        read_claims(text + "\n" + ROW.format("line", "slowest speed (m/s)", "about 0.2"))
    for arguments, quantity in (("line", "tallest (m)"), ("stability line", "final A (N)")):
        with pytest.raises(ScenarioError, match=rf"claim on {arguments} = {quantity[:4]}.*: give"):
            read_claims(ROW.format(arguments, quantity, "0.2"))
    with pytest.raises(ScenarioError, match="a text without claims"):
        read_claims("nothing")


PARAGRAPH = """
- A first item of 0.7 m/s.
- The carriers end at 0.92–0.93 m/s,
  whatever the load does.
<!-- measured
{}
-->
- Another one of 0.5 m/s.
"""


def test_numbers_of_a_paragraph_are_claims_of_the_comment_below_it():
    row = ROW.format("line", "slowest final speed (m/s)", "0.92–0.93")
    (claim,) = read_claims(PARAGRAPH.format(row))
    assert not claim.is_in_table
    assert (claim.arguments, claim.printed) == ("line", "0.92–0.93")
    for elsewhere in ("0.7", "0.5", "0.92–0.94", "≤ 0.9"):
        row = ROW.format("line", "slowest final speed (m/s)", elsewhere)
        with pytest.raises(ScenarioError, match="print in the paragraph above"):
            read_claims(PARAGRAPH.format(row))


@pytest.mark.nightly("benchmarks")
@pytest.mark.parametrize(
    ("arguments", "quantity", "least", "most"),
    [
        ("stability quintic control_period=0", "growth in a turn", 0, 1.001),
        (f"accuracy line {BRIEF}", "error of the load (mm)", 1e-9, 1e-3),
        (f"engines line {BRIEF}", "times the diagram", 0.5, 100),
        (f"viewer line {BRIEF}", "share of real time (%)", -50, 200),
        (
            "plans quintic load_trajectory.move_time=4 simulation_duration=5",
            "cost above the best plan (%)",
            -0.1,
            10,
        ),
    ],
)
def test_every_measure_finds_its_quantities(arguments, quantity, least, most):
    name = arguments.split()[0]
    found = [
        Claim(arguments=arguments, quantity=each, printed="1") for each in MEASURES[name].quantities
    ]
    values = dict(zip(MEASURES[name].quantities, values_of(found), strict=True))
    assert least < values[quantity] < most


@pytest.mark.parametrize(
    ("arguments", "quantity", "words"),
    [
        (
            "quintic simulation_duration=0.5 engine=diagram "
            "simulator_config.integration_scheme=explicit_euler",
            "final A (N)",
            "diverged",
        ),
        (RUN, "solve, p99 (ms)", "give a quantity that this run measures"),
        ("quintic no_such=1", "final A (N)", "no_such"),
    ],
)
def test_what_cannot_be_measured_is_an_error(arguments, quantity, words):
    claim = Claim(arguments=arguments, quantity=quantity, printed="1")
    with pytest.raises(ScenarioError, match=f"claim on .*{words}"):
        values_of([claim])


def test_the_report_names_what_fails(tmp_path, capsys, monkeypatch):
    def measure(chosen):
        return ((claim, values_of([claim])[0]) for claim in chosen)

    monkeypatch.setattr(claims, "measure", measure)  # in this process
    readme = tmp_path / "README.md"
    rows = [(RUN, "final A (N)", "1.2"), ("viewer line", "share of real time (%)", "4")]
    readme.write_text("\n".join(ROW.format(*row) for row in rows))
    assert main(["report", "--quick", "--readme", str(readme)]) == 0
    assert f"| {RUN} | final A (N) | 1.2 | 1.2 | holds |" in capsys.readouterr().out
    readme.write_text(ROW.format(RUN, "final A (N)", "1.4"))
    assert main(["report", "--only", "quintic", "--readme", str(readme)]) == 1
    assert "| 1.4 | 1.2 | **fails** |" in capsys.readouterr().out
    assert main(["report", "--only", "lime", "--readme", str(readme)]) == 2
    assert "--only = lime: give a part" in capsys.readouterr().err
