"""What `drake-nonstop blocks` and the JSON Schema tell, compared with the code they tell of."""

import dataclasses
import json
from pathlib import Path

import pytest
import yaml

import drake_nonstop.diagrams
from drake_nonstop.cli.main import main
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.scenario.choices import CHOICES, PATTERNS
from drake_nonstop.scenario.describe import choices_of, commented_scenario, parameters
from drake_nonstop.scenario.loading import load_scenario, parse_scenario, scenario_names
from drake_nonstop.scenario.schema import Scenario

FOLDER = Path(drake_nonstop.diagrams.__file__).parent / "scenarios"
CONFIGS = [config for configs in CHOICES.values() for config in configs]


@pytest.mark.parametrize("config", CONFIGS, ids=lambda config: config.__name__)
def test_parameters_are_the_fields_with_defaults_units_and_meanings(config):
    found = parameters(config)
    assert [parameter.name for parameter in found] == [f.name for f in dataclasses.fields(config)]
    assert all(parameter.meaning for parameter in found if "float" in parameter.type)
    name = next(name for name, configs in CHOICES.items() if config in configs)
    entry = ", ".join(f"{parameter.name}: {parameter.default}" for parameter in found)
    text = f"check: {{{name}: !{config.__name__.removesuffix('Config')} {{{entry}}}}}"
    assert getattr(parse_scenario(text), name) == config()


@pytest.mark.parametrize("name", CHOICES)
def test_every_block_is_listed_with_the_default_first(name, capsys):
    blocks = BOXES[name].variants if name in BOXES else PATTERNS
    choices = choices_of(name)
    assert [each.name for each in choices] == [b.__name__.removesuffix("Config") for b in blocks]
    assert f"{choices[0].name}Config" == type(getattr(Scenario(), name)).__name__
    assert main(["blocks", name]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for choice, block in zip(choices, blocks, strict=True):
        assert choice.summary.endswith(".")
        told = [choice.name, choice.summary, *(p.meaning for p in choice.parameters)]
        for ports, text in (("reads", choice.reads), ("makes", choice.makes)):
            told.append(text)
            assert all(f"{port} (" in text for port in getattr(block, ports, ()))
        assert all(" ".join(text.split()) in shown for text in told)


def test_an_unknown_box_is_told_the_boxes(capsys):
    assert main(["blocks", "plant"]) == 2
    assert "did you mean load_plant?" in capsys.readouterr().err


class Untagged(yaml.SafeLoader):
    """Reads tagged mappings as plain ones, as an editor does."""


def plain(loader, suffix, node):
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    return loader.construct_scalar(node) or {}


Untagged.add_multi_constructor("!", plain)


@pytest.fixture(scope="module")
def schema(tmp_path_factory):
    path = tmp_path_factory.mktemp("schema") / "s.json"
    assert main(["schema", "--out", str(path)]) == 0
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def faults(schema):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft7Validator.check_schema(schema)
    validator = jsonschema.Draft7Validator(schema)
    return lambda text: list(validator.iter_errors(yaml.load(text, Untagged)))


def test_scenarios_keep_the_schema(faults):
    for name in scenario_names():
        assert faults((FOLDER / f"{name}.yaml").read_text()) == []
    for name in ("quintic", "aircraft_transfer_rising_wind"):
        assert faults(commented_scenario(load_scenario(name), "mine")) == []
    for entry in ("system: {load_mass: !Uniform {min: 0.5, max: 1.0}}", "errors: {wind: {}}"):
        assert faults(f"a: {{{entry}}}") == []


@pytest.mark.parametrize(
    "text",
    [
        "a: {system: {load_mas: 1}}",
        "a: {sistem: {}}",
        "a: {phase: !ShapedPhase {bandwith: 3}}",
        "a: {control_period: fast}",
        "a: {simulator_config: {max_step_size: small}}",
        "a: {system: {attachments: [[1, 2, three]]}}",
        "a: {}\nb: {}",
    ],
)
def test_what_is_misspelled_does_not(faults, text):
    assert faults(text)


def test_the_schema_has_units_and_tags(schema):
    fields = schema["additionalProperties"]["properties"]
    assert fields["control_period"]["description"].startswith("s, sample time")
    assert "!ShapedPhase, !AccumulatedPhase" in fields["phase"]["description"]
    assert "!ShapedPhase mapping" in schema["yaml.customTags"]
