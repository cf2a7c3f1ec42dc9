"""The README's numbers, measured anew: what holds and what does not."""

import dataclasses
import re
from functools import partial

import pytest

from benchmarks import claims
from benchmarks.__main__ import main
from benchmarks.claims import (
    LOOP_QUANTITIES,
    QUANTITIES,
    Claim,
    Measured,
    measure,
    read_claims,
    unresolved_quantities,
    wrong_claims,
)
from benchmarks.speed_claims import BENCHMARKS, _of_scenario
from drake_nonstop.run.metrics import METRICS
from drake_nonstop.studies.run_all import SerialExecutor, run_all
from drake_nonstop.validation import ScenarioError

RUN = "quintic simulation_duration=0.1 optimization_layer=ConstantParameters"
ROW = "| `{}` | {} | | {} |"


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Has claims measured one after the other, without processes."""
    monkeypatch.setattr(claims, "run_all", partial(run_all, executor=SerialExecutor()))


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


def test_rows_that_cannot_be_read_are_no_silent_gap():
    text = ROW.format("line", "slowest speed (m/s)", "0.2")
    assert len(read_claims(text)) == 1
    with pytest.raises(ScenarioError, match=r"claim = .*with ours a number"):
        read_claims(text + "\n" + ROW.format("line", "slowest speed (m/s)", "about 0.2"))
    with pytest.raises(ScenarioError, match=r"claim on line = tallest .m.: give one of"):
        read_claims(ROW.format("line", "tallest (m)", "0.2"))
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


def test_a_claim_on_the_linearized_loop_is_measured_by_linearizing_it():
    arguments = "stability quintic control_period=0"
    claims = [Claim(arguments=arguments, quantity=name, printed="≤ 0") for name in LOOP_QUANTITIES]
    values = {claim.quantity: found.value for claim, found in measure(claims).items()}
    assert values["stable (1: yes)"] == 1
    assert values["growth rate (1/s)"] < 1e-3
    assert values["growth in a turn"] < 1.001
    with pytest.raises(ScenarioError, match=r"final A .N.: give one of stable"):
        read_claims(ROW.format(arguments, "final A (N)", "1"))


def test_a_claim_of_speed_holds_within_a_factor_and_its_errors_to_their_digits():
    speed = Claim(arguments="bench accuracy quintic", quantity="times real time", printed="9.8")
    assert speed.holds(5.0)
    assert speed.holds(19.0)
    assert not speed.holds(4.8)
    assert not speed.holds(20.0)
    error = dataclasses.replace(speed, quantity="error of the load (mm)", printed="0.0007")
    assert error.holds(0.00066)
    assert not error.holds(0.0009)


def test_claims_of_speed_are_measured_by_their_benchmark(monkeypatch):
    asked = []

    def found(scenario, progress):
        asked.append(scenario.simulation_duration)
        return {"cost_of_real_time": 0.05}

    viewer = dataclasses.replace(BENCHMARKS["viewer"], measure=_of_scenario(found))
    monkeypatch.setitem(BENCHMARKS, "viewer", viewer)
    row = ROW.format("bench viewer quintic simulation_duration=2", "share of real time (%)", "4")
    (claim,) = read_claims(row)
    assert measure([claim]) == {claim: Measured(value=5.0)}
    assert asked == [2.0]
    for arguments in ("bench viewer", "bench nothing quintic", "bench run quintic"):
        with pytest.raises(ScenarioError, match="claim on bench"):
            read_claims(ROW.format(arguments, "share of real time (%)", "4"))


def test_every_metric_that_is_one_value_can_be_claimed():
    assert {metric.heading for metric in METRICS if not metric.is_list} < set(QUANTITIES)
    assert {"mean position error (mm)", "slowest speed (m/s)", "final A (N)"} < set(QUANTITIES)


@pytest.mark.parametrize(
    ("arguments", "quantity", "words"),
    [
        (
            "quintic simulation_duration=0.5 simulator_config.integration_scheme=explicit_euler",
            "final A (N)",
            "diverged",
        ),
        (RUN, "solve, p99 (ms)", "give a quantity that this run measures"),
        ("quintic phase=Nope", "final A (N)", "phase = !Nope: give one of"),
    ],
)
def test_a_claim_that_cannot_be_measured_is_named(arguments, quantity, words):
    claim = Claim(arguments=arguments, quantity=quantity, printed="1")
    with pytest.raises(ScenarioError, match=re.escape(words)) as raised:
        measure([claim])
    assert str(raised.value).startswith(f"claim on {arguments} = ")


def test_command_fails_with_a_claim(tmp_path, capsys):
    readme = tmp_path / "README.md"
    rows = [("final A (N)", "1.2"), ("time below the bound (s)", "0")]
    arguments = ["report", "--quick", "--readme", str(readme), "--out", str(tmp_path / "out")]
    readme.write_text("\n".join(ROW.format(RUN, *row) for row in rows))
    assert main(arguments) == 0
    readme.write_text("\n".join(ROW.format(RUN, *row) for row in [*rows, ("final A (N)", "1.4")]))
    assert main(arguments) == 1
    assert "final A (N) = 1.2, not 1.4" in capsys.readouterr().err
    assert "**fails**" in (tmp_path / "out" / "report.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "is_of_a_step"),
    [
        ("quintic", False),
        ("line phase=PaperPhase", False),
        ("line load_trajectory.blend_time=2 simulator_config.max_step_size=0.001", True),
        ("paper_line load_trajectory.blend_time=0", True),
    ],
)
def test_what_the_step_does_not_resolve_is_claimed_of_that_step_only(arguments, is_of_a_step):
    claim = Claim(arguments=arguments, quantity="slack (s)", printed="9")
    in_doubt = Measured(value=9.0, is_resolved=False)
    assert wrong_claims({claim: Measured(value=9.0)}) == []
    assert len(wrong_claims({claim: Measured(value=8.0, is_resolved=False)})) == 1
    said = f"{arguments}: slack (s) = 9 is not resolved by its step"
    assert wrong_claims({claim: in_doubt}) == ([] if is_of_a_step else [said])


def test_only_what_half_the_step_leaves_is_resolved():
    moved = METRICS[[metric.heading for metric in METRICS].index("slack (s)")]

    @dataclasses.dataclass
    class FakeRun:
        unresolved: tuple = ("the slack is not",)
        half_step: dict | None = None

    compared = FakeRun(half_step={"step_s": 0.0025, "moved": {moved.path: [9.0, 7.0]}})
    assert unresolved_quantities(FakeRun(unresolved=())) == set()
    assert unresolved_quantities(FakeRun()) == set(QUANTITIES)
    unresolved = unresolved_quantities(compared)
    assert {"slack (s)", "first within 3 % of the bound (s)"} <= unresolved
    assert "mean position error (mm)" not in unresolved


def test_what_a_run_does_not_resolve_is_measured_as_such(monkeypatch):
    monkeypatch.setattr(claims, "unresolved_quantities", lambda run: {"final A (N)"})
    printed = {"final A (N)": "1.2", "time below the bound (s)": "0"}
    on_run = [Claim(arguments=RUN, quantity=name, printed=text) for name, text in printed.items()]
    values = measure(on_run)
    assert [values[claim].is_resolved for claim in on_run] == [False, True]
    (wrong,) = wrong_claims(values)
    assert wrong == f"{RUN}: final A (N) = 1.2 is not resolved by its step"


@pytest.mark.nightly("benchmarks")
def test_a_run_that_its_step_does_not_resolve_fails_its_claim():
    points = "[[0.8,0.75,0],[-0.75,0.7,0],[-0.75,-0.75,0],[0.75,-0.75,0]]"
    arguments = f"quintic simulation_duration=2 simulated.attachments={points}"
    claim = Claim(arguments=arguments, quantity="slowest final speed (m/s)", printed="1")
    assert not measure([claim])[claim].is_resolved


def test_without_a_readme_there_is_a_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["report"]) == 2
    assert "--readme = README.md: run it in a checkout" in capsys.readouterr().err
