"""The JSON Schema of scenario files: all shipped ones keep it, and misspelled fields do not."""

import json
from pathlib import Path

import pytest
import yaml

import drake_nonstop.diagrams
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.describe import commented_scenario, custom_tags, scenario_schema
from drake_nonstop.scenario.loading import load_scenario, scenario_names

FOLDER = Path(drake_nonstop.diagrams.__file__).parent / "scenarios"


OWN_BLOCK = """
from dataclasses import dataclass
from drake_nonstop.blocks.phase import AccumulatedPhase

@dataclass(kw_only=True)
class SlowerConfig:
    slowness: float = 2.0

class Slower(AccumulatedPhase):
    pass
"""


class Untagged(yaml.SafeLoader):
    """Reads tagged mappings as plain ones, as an editor does."""


def plain(loader, suffix, node):
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    return loader.construct_scalar(node) or {}


Untagged.add_multi_constructor("!", plain)


@pytest.fixture(scope="module")
def schema():
    return json.loads(json.dumps(scenario_schema()))


@pytest.fixture(scope="module")
def faults(schema):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft7Validator.check_schema(schema)
    validator = jsonschema.Draft7Validator(schema)
    return lambda text: list(validator.iter_errors(yaml.load(text, Untagged)))


@pytest.mark.parametrize("name", scenario_names())
def test_shipped_scenarios_keep_it(faults, name):
    assert faults((FOLDER / f"{name}.yaml").read_text()) == []


@pytest.mark.parametrize("name", ["quintic", "aircraft_transfer_rising_wind"])
def test_scenarios_with_every_field_keep_it(faults, name):
    assert faults(commented_scenario(load_scenario(name), "mine")) == []


@pytest.mark.parametrize(
    "text",
    [
        "a: {system: {load_mas: 1}}",
        "a: {sistem: {}}",
        "a: {phase: !ShapedPhase {bandwith: 3}}",
        "a: {control_period: fast}",
        "a: {simulator_config: {max_step_siz: 0.01}}",
        "a: {simulator_config: {max_step_size: small}}",
        "a: {system: {attachments: [[1, 2, three]]}}",
        "a: {}\nb: {}",
    ],
)
def test_what_is_misspelled_does_not(faults, text):
    assert faults(text)


def test_distributions_keep_it(faults):
    assert faults("a: {system: {load_mass: !Uniform {min: 0.5, max: 1.0}}}") == []


@pytest.mark.slow
def test_fields_have_units_and_blocks(schema):
    fields = schema["additionalProperties"]["properties"]
    assert fields["control_period"]["description"].startswith("s, sample time")
    phase = fields["phase"]["anyOf"][1]["properties"]
    assert phase["bandwidth"]["description"] == "rad/s, of each of three equal poles"
    assert "!ShapedPhase, !AccumulatedPhase" in fields["phase"]["description"]
    assert "!ShapedPhase mapping" in custom_tags()


@pytest.mark.slow
def test_blocks_of_ones_own_keep_it_where_their_scenario_is_given(
    schema, tmp_path, monkeypatch, capsys
):
    jsonschema = pytest.importorskip("jsonschema")
    (tmp_path / "schema_blocks.py").write_text(OWN_BLOCK)
    (tmp_path / "own.yaml").write_text("own: {phase: !schema_blocks.Slower {slowness: 3.0}}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    text = "own: {phase: {slowness: 3.0}}"
    plain_schema = jsonschema.Draft7Validator(schema)
    assert list(plain_schema.iter_errors(yaml.safe_load(text)))
    assert main(["schema", "own.yaml", "--trust"]) == 0
    own = jsonschema.Draft7Validator(json.loads(capsys.readouterr().out))
    assert not list(own.iter_errors(yaml.safe_load(text)))
    assert list(own.iter_errors(yaml.safe_load("own: {phase: {slownes: 3.0}}")))
    assert main(["schema", "own.yaml", "--trust", "--tags"]) == 0
    assert "!schema_blocks.Slower mapping" in json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_the_command_writes_it(schema, tmp_path, capsys):
    assert main(["schema", "--out", str(tmp_path / "s.json")]) == 0
    assert json.loads((tmp_path / "s.json").read_text()) == schema
    capsys.readouterr()
    assert main(["schema", "--tags"]) == 0
    assert json.loads(capsys.readouterr().out) == custom_tags()
