"""Obstacles in scenario files: they come back, and what is wrong is told in one sentence."""

import pytest
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from drake_nonstop import Scenario, ScenarioError, dump_scenario, load_scenario, parse_scenario

TEXT = """
a:
  based_on: line
  obstacles:
    - !Box {name: tower, position: [5, 0, 3], size: [1, 1, 6]}
    - !Sphere {position: [1, !Uniform {min: 0, max: 1}, 3]}
    - !Ground {height: -1}
"""


def test_obstacles_come_back():
    scenario = parse_scenario(TEXT)
    assert parse_scenario(dump_scenario(scenario)) == scenario
    sampled = scenario.sampled()
    assert 0 < sampled.obstacles[1].position[1] < 1
    assert yaml_load_typed(schema=Scenario, data=yaml_dump_typed(sampled)) == sampled


@pytest.mark.parametrize(
    ("obstacles", "said"),
    [
        (
            "[!Cone {}]",
            r"^obstacles\[0\] = !Cone: .* there are !Sphere, !Box, !Ground",
        ),
        ("[!Sphere {radius: -1}]", r"obstacles\[0\]\.radius = -1\.0: give a finite number"),
        ("[!Box {size: [1, 0, 1]}]", r"obstacles\[0\]\.size = 0\.0: give a finite number"),
        ("[!Ground {}, !Ground {}]", r"obstacles\[1\]\.name = ground: give each obstacle a name"),
        ("[!Sphere {radus: 1}]", "did you mean radius"),
        ("!Box {}", "give a list in"),
    ],
)
def test_what_is_wrong_is_told(obstacles, said):
    with pytest.raises(ScenarioError, match=said):
        load_scenario("line", [f"obstacles={obstacles}"])


def test_a_ground_reaches_down_to_all_that_is_below_it():
    ground = parse_scenario("a: {obstacles: [!Ground {height: 1e9}]}").obstacles[0].shape()
    assert ground.position[2] - ground.half[2] < -1e9 < 1e9 == ground.position[2] + ground.half[2]
