"""What `drake-nonstop blocks` and the JSON Schema tell, compared with the code they tell of."""

import dataclasses
import json
import re
from pathlib import Path

import pytest
import yaml
from registries import VARIANTS

import drake_nonstop.diagrams
from drake_nonstop import Scenario, parse_scenario, scenario_names
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.choices import CHOICES

FOLDER = Path(drake_nonstop.diagrams.__file__).parent / "scenarios"
ROW = re.compile(r"(?m)^    (\w+) {2,}(\S.*?) {2,}(\S.*?)(?: {2,}\S.*)?$")


@pytest.mark.parametrize("box", CHOICES)
def test_every_block_is_listed_with_its_ports_and_parameters_and_their_defaults(box, capsys):
    assert main(["blocks", box]) == 0
    parts = re.split(r"\n\n  (?=\w)", capsys.readouterr().out)[1:]
    assert type(getattr(Scenario(), box)) is CHOICES[box][0]
    blocks = {kind.__name__: kind for owner, kind in VARIANTS.values() if owner == box}
    for config, part in zip(CHOICES[box], parts, strict=True):
        name = config.__name__.removesuffix("Config")
        assert part.startswith(f"{name} (default)\n" if config is CHOICES[box][0] else f"{name}\n")
        ports = " ".join(part.split())
        for kind in ("reads", "makes"):
            assert all(f" {port} (" in ports for port in getattr(blocks.get(name), kind, ()))
        rows = ROW.findall(part)
        assert [row[0] for row in rows] == [field.name for field in dataclasses.fields(config)]
        entry = ", ".join(f"{field}: {value}" for field, _, value in rows)
        text = f"check: {{{box}: !{name} {{{entry}}}}}"
        assert getattr(parse_scenario(text), box) == config()


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


def test_scenarios_keep_the_schema(faults, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in scenario_names():
        assert faults((FOLDER / f"{name}.yaml").read_text()) == []
    for name in ("quintic", "aircraft_transfer_rising_wind"):
        assert main(["new", f"my_{name}", "--from", name]) == 0
        assert faults(Path(f"my_{name}.yaml").read_text()) == []
    for entry in ("system: {load_mass: !Uniform {min: 0.5, max: 1.0}}", "errors: {wind: {}}"):
        assert faults(f"a: {{{entry}}}") == []


@pytest.mark.parametrize(
    "text",
    [
        "a: {system: {load_mas: 1}}",
        "a: {phase: !ShapedPhase {bandwith: 3}}",
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
