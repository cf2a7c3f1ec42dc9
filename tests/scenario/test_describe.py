"""What `drake-nonstop blocks` tells, compared with the code that it tells of."""

import dataclasses

import numpy as np
import pytest
from helpers import regular, sizes_of

from drake_nonstop.cli.main import main
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.mechanics.internal_force import even_phases, hamiltonian_cycle
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import LinearPatternConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.scenario.choices import CHOICES, PATTERNS
from drake_nonstop.scenario.describe import box_names, describe, parameters
from drake_nonstop.scenario.loading import parse_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems import wiring
from drake_nonstop.validation import ScenarioError


@pytest.fixture(scope="module")
def boxes():
    return {name: describe(name) for name in box_names()}


CONFIGS = [config for configs in CHOICES.values() for config in configs]
configs = pytest.mark.parametrize("config", CONFIGS, ids=lambda config: config.__name__)


@configs
def test_every_parameter_has_a_unit_or_a_meaning(config):
    for parameter in parameters(config):
        if "float" in parameter.type:
            assert parameter.meaning, f"{config.__name__}.{parameter.name} has no comment"


@configs
def test_parameters_are_the_fields_of_the_config_with_their_defaults(config):
    found = parameters(config)
    default = config()
    assert [parameter.name for parameter in found] == [f.name for f in dataclasses.fields(config)]
    field_name = next(name for name, configs in CHOICES.items() if config in configs)
    tag = config.__name__.removesuffix("Config")
    entry = ", ".join(f"{parameter.name}: {parameter.default}" for parameter in found)
    scenario = parse_scenario(f"check: {{{field_name}: !{tag} {{{entry}}}}}")
    assert getattr(scenario, field_name) == default


@pytest.mark.slow
def test_every_box_and_block_is_listed_with_the_default_first(boxes):
    assert list(boxes) == [*BOXES, "pattern"]
    for name, box in BOXES.items():
        choices = boxes[name].choices
        assert [choice.name for choice in choices] == [block.__name__ for block in box.variants]
        assert {port.name: port.layout for port in boxes[name].signals} == box.signals
    names = [config.__name__.removesuffix("Config") for config in PATTERNS]
    assert [choice.name for choice in boxes["pattern"].choices] == names
    for box in boxes.values():
        default = type(getattr(Scenario(), box.name)).__name__
        assert f"{box.choices[0].name}Config" == default
        assert all(choice.summary.endswith(".") for choice in box.choices)


@pytest.mark.parametrize(("n", "m"), [(3, 3), (5, 6)])
def test_every_port_is_listed_with_its_size_whatever_n_and_m_are(boxes, n, m):
    edges = np.arange(m) % n
    pattern = LinearPatternConfig(
        basis=hamiltonian_cycle(regular(n))[:, edges].tolist(),
        phases=even_phases(n)[edges].tolist(),
    )
    system = SystemParameters(
        attachments=regular(n).tolist(), aircraft=AircraftParameters(model="rascal_110")
    )
    model = Model(system, pattern, 0.01)
    sizes = {s: k for box in BOXES.values() for s, k in sizes_of(box, n, m).items()}
    texts = {
        signal: "abstract" if layout is None else layout.size
        for box in BOXES.values()
        for signal, layout in box.signals.items()
    }
    for single in ("sample_time", "speed_bound_command"):
        sizes[single], texts[single] = 1, "1"
    for name, box in BOXES.items():
        for block, choice in zip(box.variants, boxes[name].choices, strict=True):
            built = block(model)
            for ports, told in (
                (wiring.input_sizes(built), choice.inputs),
                (wiring.output_sizes(built), choice.outputs),
            ):
                assert [port.name for port in told] == list(ports)
                for port in told:
                    signal = port.name.removeprefix("held_")
                    assert port.size == texts[signal]
                    own = getattr(built, "signal_layouts", {}).get(port.name)
                    size = sizes[signal] if own is None else own.count(n, m)
                    assert size == ports[port.name]


def test_unknown_box_is_told_the_boxes(capsys):
    with pytest.raises(ScenarioError, match=r"^box = plant: .*did you mean load_plant\?"):
        describe("plant")
    assert main(["blocks", "plant"]) == 2
    assert capsys.readouterr().err.startswith("drake-nonstop: box = plant: there is no plant")


def test_one_box_is_shown_alone(capsys):
    assert main(["blocks", "optimization_layer"]) == 0
    shown = capsys.readouterr().out
    assert (
        "\noptimization_layer -> parameters (2); "
        "optional diagnostics (7), plan (8), solve_time (1),\n"
        "                      speed_bound (1), missed_limits (some), measured_margin (1)\n"
    ) in shown
    assert (
        "  RecedingHorizonOptimizer (default)\n"
        "    Plans ξ and A over a horizon such that every carrier stays at or above ε.\n"
        "    in   reference (22), wind_estimate (3, optional), held_carrier_state (6n, optional),\n"
        "         speed_bound_command (1, optional), sample_time (1), reference_preview (abstract, "
        "optional)\n"
        "    out  parameters (2), plan (8), diagnostics (7), solve_time (1), speed_bound (1), "
        "missed_limits\n"
        "         (some), measured_margin (1)\n"
    ) in shown
    assert "  PaperLayer\n    Changes ξ and A as little" in shown
    assert (
        "    in   phase (2), measured_load_state (13), reference (22), wrench (6), "
        "wrench_rate (6),\n"
        "         wind_estimate (3, optional), speed_bound_command (1, optional)\n"
        "    out  parameters (2), diagnostics (7), solve_time (1), speed_bound (1)\n"
        "    speed_bound                 float | str  0.2          m/s, ε; of aircraft also "
        '"1.4 V_s"\n'
    ) in shown
    assert shown.endswith(
        "  ConstantParameters\n"
        "    Constant ξ and A: the loop without optimization.\n"
        "    in   speed_bound_command (1, optional)\n"
        "    out  parameters (2), speed_bound (1)\n"
        "    frequency    float        2.0  rad/s, ξ\n"
        "    amplitude    float        1.2  N, A; 0 for a constant pattern, and for no other\n"
        '    speed_bound  float | str  0.2  m/s, ε; reported, not enforced; also "1.4 V_s"\n'
    )
    assert "load_plant" not in shown
