"""Scenarios that name another one that they are based on."""

import pytest

from drake_nonstop import ScenarioError, dump_scenario, load_scenario, parse_scenario


def resolved(scenario):
    """The scenario's fields, without its name."""
    return dump_scenario(scenario).partition("\n")[2]


def test_nothing_but_the_name_changes_where_nothing_else_is_given():
    copy = parse_scenario("copy: {based_on: quintic}")
    assert copy.name == "copy"
    assert copy.description == ""
    assert resolved(copy) == resolved(load_scenario("quintic", ["description=''"]))


def test_parts_are_merged_field_by_field_and_so_is_the_same_block():
    text = """
    heavy:
      based_on: quintic
      description: with more mass
      system: {load_mass: 1.2}
      pattern:  # nothing of it changes
      load_trajectory: {move_time: 8.0}
      optimization_layer: {tightening: 0.03}
    """
    overrides = [
        "description=with more mass",
        "system.load_mass=1.2",
        "load_trajectory.move_time=8.0",
        "optimization_layer.tightening=0.03",
    ]
    assert resolved(parse_scenario(text)) == resolved(load_scenario("quintic", overrides))


def test_a_tag_means_the_same_in_a_file_and_by_an_override():
    five = "[[1, 0, 0], [0.3, 1, 0], [-0.8, 0.6, 0], [-0.8, -0.6, 0], [0.3, -1, 0]]"
    entries = {"system.attachments": five, "pattern": "!HamiltonianCycle {}"}
    changes = f"system: {{attachments: {five}}}, pattern: !HamiltonianCycle {{}}"
    text = f"x: {{based_on: quintic, {changes}}}"
    by_set = load_scenario("quintic", [f"{path}={value}" for path, value in entries.items()])
    assert resolved(parse_scenario(text)).splitlines()[1:] == resolved(by_set).splitlines()[1:]
    assert by_set.pattern.phases == []
    changes = "optimization_layer: {tightening: 0.03}, load_trajectory: {move_time: 8}"
    settings = ["optimization_layer={tightening: 0.03}", "load_trajectory.move_time=8"]
    in_file = parse_scenario(f"x: {{based_on: quintic, {changes}}}")
    assert in_file.optimization_layer == load_scenario("quintic", settings).optimization_layer
    assert in_file.optimization_layer.speed_bound == 0.55


def test_another_block_begins_with_its_own_defaults():
    text = "other: {based_on: quintic, optimization_layer: !ConstantParameters {frequency: 1.5}}"
    layer = parse_scenario(text).optimization_layer
    assert (layer.frequency, layer.amplitude, layer.speed_bound) == (1.5, 1.2, 0.2)


def test_a_chain_of_files_is_found_from_folder_to_folder(tmp_path):
    (tmp_path / "bases").mkdir()
    (tmp_path / "bases" / "a.yaml").write_text("a: {based_on: line, simulation_duration: 3.0}")
    (tmp_path / "bases" / "b.yaml").write_text("b: {based_on: a.yaml, system: {load_mass: 1.1}}")
    (tmp_path / "c.yaml").write_text("c: {based_on: bases/b.yaml, description: mine}")
    scenario = load_scenario(tmp_path / "c.yaml", ["system.load_drag=0.5"])
    overrides = [
        "simulation_duration=3.0",
        "system.load_mass=1.1",
        "system.load_drag=0.5",
        "description=mine",
    ]
    assert resolved(scenario) == resolved(load_scenario("line", overrides))


def test_the_resolved_scenario_stands_alone():
    text = dump_scenario(parse_scenario("mine: {based_on: three_carriers}"))
    assert "based_on" not in text
    assert dump_scenario(parse_scenario(text)) == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "x: {based_on: quintik}",
            r"^based_on = quintik: .*did you mean quintic\?",
        ),
        ("x: {based_on: 3}", r"^based_on = 3: give a scenario's name"),
        ("x: {based_on: [line]}", r"^based_on = \['line'\]: give a scenario's name"),
        ("x: {based_on: gone.yaml}", r"^based_on = gone\.yaml: give a file that can be read"),
        ("x: {based_on: line, duraton: 3}", r"^duraton = 3: there is no duraton"),
        ("x: {based_onn: line}", r"^based_onn = line: .*did you mean based_on\?"),
        ("x: {based_on: line, system: 3}", "system = 3: give it as SystemParameters"),
        ("x: {based_on: line, phase: !Nothing {}}", "phase = !Nothing: there is no"),
    ],
)
def test_a_base_that_cannot_be_used_is_told(text, message):
    with pytest.raises(ScenarioError, match=message):
        parse_scenario(text)


def test_files_based_on_each_other_are_refused(tmp_path):
    (tmp_path / "a.yaml").write_text("a: {based_on: b.yaml}")
    (tmp_path / "b.yaml").write_text("b: {based_on: a.yaml}")
    for name in ("a.yaml", "b.yaml"):
        with pytest.raises(ScenarioError, match=r"based_on = .*: it is based on this scenario"):
            load_scenario(tmp_path / name)
    (tmp_path / "c.yaml").write_text("c: {based_on: c.yaml}")
    with pytest.raises(ScenarioError, match=r"^based_on = c\.yaml: it is based on this"):
        load_scenario(tmp_path / "c.yaml")


def test_blocks_of_ones_own_in_a_base_ask_for_trust(tmp_path):
    (tmp_path / "base.yaml").write_text("base: {phase: !no_such_module.Phase {}}")
    (tmp_path / "mine.yaml").write_text("mine: {based_on: base.yaml}")
    with pytest.raises(ScenarioError, match="runs code of its own"):
        load_scenario(tmp_path / "mine.yaml")
