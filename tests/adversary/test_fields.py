"""Each declared field takes what it is declared for; any other value is one sentence."""

import contextlib
import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from adversary.conftest import COUNT
from adversary.drawn import FIELDS, OTHERS, SHORT, SPELLINGS, VALUES, as_yaml, changes
from adversary.judging import ACCEPTED, REFUSED, ending_of, read_back_and_flown
from drake_nonstop import (
    ScenarioError,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    scenario_names,
    simulate,
)

LAYER = "optimization_layer=ConstantParameters"  # which is built the fastest


def test_the_fields_are_those_of_all_parts_and_blocks():
    assert len({field.form for field in FIELDS}) == len(FIELDS) > 200


@pytest.mark.parametrize(
    ("value", "is_for"),
    [(".nan", {float, int, bool}), ("'5'", {float, int, bool}), ("5", {str}), ("1.5", {int, bool})],
)
def test_no_field_takes_a_value_of_another_type(value, is_for):
    """NaN, quoted numbers, numbers for texts, and fractions of a whole number; also in a list."""
    taken = []
    for field in FIELDS:
        kinds, text = field.kinds, value
        if isinstance(field.default, list) and field.default:
            kinds, text = {type(field.default[0])}, as_yaml([value, *field.default[1:]])
        if not kinds & is_for or kinds & ({float, int, str, list} - is_for):
            continue
        with contextlib.suppress(ScenarioError):
            load_scenario(field.scenario, [field.change(text)])
            taken.append(field.change(text))
    assert taken == []


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_a_spelling_is_a_number_to_all_readers_or_refused(spelling):
    meant = SPELLINGS[spelling]
    forms = [
        lambda: load_scenario("quintic", [f"load_trajectory.displacement=[0.5, {spelling}, 0.5]"]),
        lambda: parse_scenario(
            f"a: {{load_trajectory: !RestToRest {{displacement: [0.5, {spelling}, 0.5]}}}}"
        ),
    ]
    for form in forms if "," not in spelling else ():
        ending, found = ending_of(form)
        assert ending == (REFUSED if meant is None else ACCEPTED), found
        if meant is not None:
            assert found.load_trajectory.displacement == [0.5, meant, 0.5]


@pytest.mark.parametrize(
    "text",
    [
        "a: {system: {load_mass: 1, load_mass: 1}}",
        "a: {simulation_duration: 1}\na: {simulation_duration: 1}",
        "a:\n  system:\n    gravity: 9\n  phase: !PaperPhase {}\n  system:\n    gravity: 9",
        "a: {wind: !SteadyWind {velocity: [1, 0, 0], velocity: [1, 0, 0]}}",
    ],
)
def test_a_key_is_given_once(text):
    ending, said = ending_of(lambda: parse_scenario(text))
    assert ending == REFUSED
    assert "twice" in said


@given(changes())
@example(("quintic", "system.load_mass='1'"))
@example(("quintic", "simulator_config.max_step_size=1e-300"))
def test_a_change_is_one_sentence_or_flies_and_reads_back(change):
    name, override = change
    given_layer = [] if override.startswith("optimization_layer") else [LAYER]
    ending, scenario = ending_of(lambda: load_scenario(name, [SHORT, *given_layer, override]))
    if ending == ACCEPTED:
        read_back_and_flown(scenario)


@settings(max_examples=int(COUNT or 4))
@given(st.sampled_from([name for name in scenario_names() if "_cables" not in name]), changes())
def test_a_change_of_any_scenario_in_a_file_is_one_sentence_or_flies(name, change):
    path, _, value = change[1].partition("=")
    keys = path.split(".")
    lines = [f"{'  ' * (k + 1)}{key}:" for k, key in enumerate(keys)]
    text = "\n".join(["mine:", f"  based_on: {name}", *lines]) + f" {value}"
    ending, scenario = ending_of(lambda: parse_scenario(text))
    if ending == ACCEPTED:
        scenario.simulation_duration = 0.02
        read_back_and_flown(scenario)


@given(st.sampled_from(FIELDS), st.sampled_from(["gain", "_tag", "x" * 400, "é", "1", ""]), VALUES)
def test_an_unknown_field_is_refused(field, slip, value):
    change = f"{field.form.partition('=')[0]}.{slip}={value}"
    assert ending_of(lambda: load_scenario(field.scenario, [change]))[0] == REFUSED


@given(st.data())
def test_a_damaged_text_is_one_sentence_or_a_scenario(data):
    """Cut off, or with characters that are put in, replaced or left out."""
    text = dump_scenario(load_scenario(data.draw(st.sampled_from(scenario_names()))))
    k = data.draw(st.integers(0, len(text)))
    put = data.draw(st.one_of(st.text("{}[]:,!&*#|>%@`'\"\t\0-?é \n", max_size=3), OTHERS))
    left_out = data.draw(st.sampled_from([0, 0, 1, 2, 1_000_000]))
    ending_of(lambda: parse_scenario(text[:k] + put + text[k + left_out :]))


@given(st.sampled_from([2, 19, 300, 3000]), st.sampled_from(["[]", "{a: }", "!A {a: }"]))
def test_nested_values_are_refused(depth, pair):
    change = f"simulation_duration={pair[:-1] * depth}1{pair[-1] * depth}"
    assert ending_of(lambda: load_scenario("quintic", [change]))[0] == REFUSED


@given(st.integers(3, 40), st.integers(2, 12))
def test_aliases_that_stand_for_very_much_are_refused(levels, width):
    bomb = [f"    - &a{k} [{', '.join([f'*a{k - 1}'] * width)}]" for k in range(1, levels)]
    text = "\n".join(["mine:", "  obstacles:", "    - &a0 [1]", *bomb])
    assert ending_of(lambda: parse_scenario(text))[0] == REFUSED


@given(
    st.sampled_from(FIELDS),
    st.one_of(
        st.floats(),
        st.sampled_from([None, "5", "", [], {}, object(), 1j, 10**400, [float("nan")], print]),
    ),
    st.sampled_from([make_nonstop, simulate, dump_scenario]),
)
def test_what_is_assigned_in_python_is_checked_where_it_is_used(field, value, use):
    path, block, name = re.fullmatch(r"([\w.]+)=(?:(!\w+) \{(\w+): )?\{\}\}?", field.form).groups()
    path = f"{path}.{name}" if block else path
    chosen = [f"{path.partition('.')[0]}={block} {{}}"] if block else []
    owner = scenario = load_scenario(field.scenario, [SHORT, *chosen])
    *parts, name = path.split(".")
    for part in parts:
        owner = getattr(owner, part)
    try:
        setattr(owner, name, value)
    except TypeError:  # of a parameter of Drake's own
        return
    ending, _ = ending_of(lambda: use(scenario), shows_python=True)
    is_senseless = value != value or isinstance(value, complex) or value is print
    assert ending == REFUSED or not is_senseless
