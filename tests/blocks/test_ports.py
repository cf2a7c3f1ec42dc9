"""What holds for every block: sizes, direct feedthrough, and outputs that never go stale."""

import functools
import importlib
import inspect
import pkgutil
import pydoc
import re

import numpy as np
import pytest
import yaml
from helpers import Motion, fix, model, output, sizes_of, vector_outputs

from drake_nonstop import blocks
from drake_nonstop.blocks.cables import Cables
from drake_nonstop.blocks.carrier_controller import (
    CarrierPid,
    CarrierPidConfig,
    FeedforwardCarrierPid,
    TunedFeedforwardCarrierPid,
)
from drake_nonstop.blocks.carrier_dynamics import (
    CarrierDynamics,
    FixedWingDynamics,
    LimitedCarriers,
    LimitedCarriersConfig,
)
from drake_nonstop.blocks.carrier_trajectory import (
    BowedCarrierTrajectory,
    BowedCarrierTrajectoryConfig,
    CarrierTrajectory,
    CarrierTrajectoryConfig,
    MeasuredCarrierTrajectory,
)
from drake_nonstop.blocks.fixed_wing_controller import FixedWingController
from drake_nonstop.blocks.force_distribution import (
    CableForceDistribution,
)
from drake_nonstop.blocks.internal_force import PlannedInternalForce
from drake_nonstop.blocks.load_disturbance import (
    DisturbanceForce,
    DisturbanceForceConfig,
    NoDisturbance,
)
from drake_nonstop.blocks.load_feedback import (
    DesiredAttitudeFeedback,
    DesiredStateFeedback,
    FilteredFeedback,
    IdealFeedback,
    NoisyFeedback,
    NoisyFeedbackConfig,
)
from drake_nonstop.blocks.load_plant import LoadPlant, MultibodyLoadPlant
from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMove,
    PlannedTurn,
    RestToRest,
    RestToRestConfig,
    SampledTrajectory,
    Waypoints,
)
from drake_nonstop.blocks.lumped_cables import LumpedCables, LumpedCablesConfig
from drake_nonstop.blocks.optimization_layer import ConstantParameters, PaperLayer
from drake_nonstop.blocks.phase import AccumulatedPhase, PaperPhase, ShapedPhase
from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.blocks.wind import (
    GustyWind,
    GustyWindConfig,
    SteadyWind,
    SteadyWindConfig,
    StillAir,
)
from drake_nonstop.blocks.wind_estimator import (
    KnownWind,
    LoadAnemometer,
    NoWind,
    WindObserver,
)
from drake_nonstop.blocks.wrench_controller import (
    PaperWrenchController,
    TunedWrenchController,
    WrenchController,
)
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS
from drake_nonstop.loop.box import config_class
from drake_nonstop.mechanics.signals import SIGNALS as LAYOUTS
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.scenario.describe import parameters
from drake_nonstop.systems.wiring import output_sizes


def moving_reference(model):
    return RestToRest(
        model, RestToRestConfig(displacement=[1, 2, 3], roll_pitch_yaw=[0.1, 0.2, 0.3])
    )


def integrating_pid(model):
    return CarrierPid(model, CarrierPidConfig(integral_gain=3.0))


def noisy_feedback(model):
    return NoisyFeedback(model, NoisyFeedbackConfig(position_noise=0.1, orientation_noise=0.1))


def gusty_force(model):
    return DisturbanceForce(model, DisturbanceForceConfig(gust_force=1.0))


def rising_wind(model):
    return SteadyWind(model, SteadyWindConfig(rise_time=8.0))


def gusty_wind(model):
    config = GustyWindConfig(velocity=[3, 1, 1], load_gust=0.3)
    return GustyWind(model, config)


def loaded_carriers(model):
    return LimitedCarriers(model, LimitedCarriersConfig(has_weight=True, feels_cable=True))


def first_order_trajectory(model):
    return CarrierTrajectory(model, CarrierTrajectoryConfig(hold="velocity"))


def everything(inputs, outputs):
    """Ports of which every output depends on every input."""
    return inputs, outputs, [(source, target) for source in inputs for target in outputs]


# What an aircraft's command follows; the acceleration is for the observer.
_FLIGHT = (
    "carrier_reference",
    "carrier_reference_acceleration",
    "carrier_reference_jerk",
    "carrier_state",
    "aircraft_state",
    "desired_cable_forces",
    "desired_cable_force_rates",
    "wind_estimate",
    "cable_drag_and_weight",
    "cable_drag_and_weight_rates",
)

DISTRIBUTION = (
    ["measured_load_state", "wrench", "wrench_rate", "internal_force"],
    ["desired_cable_forces", "desired_cable_force_rates"],
    [
        ("measured_load_state", "desired_cable_forces"),
        ("measured_load_state", "desired_cable_force_rates"),
        ("wrench", "desired_cable_forces"),
        ("wrench", "desired_cable_force_rates"),
        ("wrench_rate", "desired_cable_force_rates"),
        ("internal_force", "desired_cable_forces"),
        ("internal_force", "desired_cable_force_rates"),
    ],
)
_PULLED = ("reference", "desired_cable_forces", "desired_cable_force_rates")
_ORBIT = ("internal_force_higher_rates", "wind_estimate", "reference_higher_rates")
_REFERENCES = ["reference", "reference_higher_rates", "reference_preview"]
_WINDS = ["wind", "load_wind", "mean_wind"]
_CABLES = ["cable_forces", "carrier_cable_forces", "tensions"]
_DERIVATIVES = ("carrier_reference_acceleration", "carrier_reference_jerk")


def lumped_cables(made):
    return LumpedCables(made, LumpedCablesConfig(nodes=1))


def bowed_trajectory(made):
    return BowedCarrierTrajectory(made, BowedCarrierTrajectoryConfig(nodes=2))


_WRENCH_INPUTS = ["measured_load_state", "reference", "wind_estimate"]
_WRENCH = ("wrench", "wrench_rate", "tracking_error")  # go by the integrals after the sample

# block: (inputs, outputs, direct feedthrough), for continuous controllers
BLOCKS = {
    moving_reference: ([], _REFERENCES, []),
    ConstantVelocityMove: ([], _REFERENCES, []),
    **dict.fromkeys(
        (WrenchController, PaperWrenchController, TunedWrenchController),
        everything([*_WRENCH_INPUTS, "reference_higher_rates"], [*_WRENCH]),
    ),
    **dict.fromkeys(
        (CarrierTrajectory, first_order_trajectory),
        (
            [*_PULLED, *_ORBIT],
            ["carrier_reference", *_DERIVATIVES],
            [
                *((source, "carrier_reference") for source in _PULLED),
                *((source, target) for source in (*_PULLED, *_ORBIT) for target in _DERIVATIVES),
            ],
        ),
    ),
    bowed_trajectory: everything(
        [*_PULLED, "planned", "wind_estimate", "reference_higher_rates", "carrier_gust_estimate"],
        [
            *("carrier_reference", *_DERIVATIVES),
            *("cable_drag_and_weight", "cable_drag_and_weight_rates", "cable_reference"),
        ],
    ),
    MeasuredCarrierTrajectory: everything(
        ["measured_load_state", "desired_cable_forces", "desired_cable_force_rates"],
        ["carrier_reference"],
    ),
    **dict.fromkeys(
        (FeedforwardCarrierPid, TunedFeedforwardCarrierPid),
        everything(
            ["carrier_reference", "carrier_state", "carrier_reference_acceleration"],
            ["carrier_forces"],
        ),
    ),
    Waypoints: ([], _REFERENCES, []),
    SampledTrajectory: ([], _REFERENCES, []),
    PlannedTurn: everything(["planned"], ["reference", "reference_higher_rates"]),
    IdealFeedback: (
        ["load_state"],
        ["measured_load_state"],
        [("load_state", "measured_load_state")],
    ),
    DesiredStateFeedback: (
        ["reference"],
        ["measured_load_state"],
        [("reference", "measured_load_state")],
    ),
    DesiredAttitudeFeedback: everything(["load_state", "reference"], ["measured_load_state"]),
    PaperLayer: (
        [
            "phase",
            "measured_load_state",
            "reference",
            "wrench",
            "wrench_rate",
            "wind_estimate",
            "speed_bound_command",
        ],
        ["parameters", "diagnostics", "solve_time", "speed_bound"],
        [("speed_bound_command", "speed_bound")],
    ),
    ConstantParameters: (
        ["speed_bound_command"],
        ["parameters", "speed_bound"],
        [("speed_bound_command", "speed_bound")],
    ),
    AccumulatedPhase: (["parameters"], ["phase", "planned"], [("parameters", "planned")]),
    PaperPhase: everything(["parameters"], ["phase", "planned"]),
    ShapedPhase: (
        ["parameters", "plan"],
        ["phase", "planned"],
        [("parameters", "planned"), ("plan", "phase"), ("plan", "planned")],
    ),
    PlannedInternalForce: everything(
        ["planned"], ["internal_force", "internal_force_higher_rates"]
    ),
    CableForceDistribution: DISTRIBUTION,
    CarrierPid: (
        ["carrier_reference", "carrier_state"],
        ["carrier_forces"],
        [("carrier_reference", "carrier_forces"), ("carrier_state", "carrier_forces")],
    ),
    integrating_pid: (
        ["carrier_reference", "carrier_state"],
        ["carrier_forces"],
        [("carrier_reference", "carrier_forces"), ("carrier_state", "carrier_forces")],
    ),
    CarrierDynamics: (["carrier_forces"], ["carrier_state"], []),
    LimitedCarriers: (["carrier_forces"], ["carrier_state"], []),
    loaded_carriers: (["carrier_forces", "carrier_cable_forces"], ["carrier_state"], []),
    FixedWingDynamics: (
        ["aircraft_command", "carrier_cable_forces", "wind"],
        ["carrier_state", "aircraft_state", "carrier_acceleration"],
        [
            ("wind", "aircraft_state"),
            ("wind", "carrier_acceleration"),
            ("carrier_cable_forces", "carrier_acceleration"),
        ],
    ),
    FixedWingController: (
        [*_FLIGHT[:-2], "carrier_acceleration", *_FLIGHT[-2:]],
        ["aircraft_command", "command_saturation"],
        [(s, t) for s in _FLIGHT for t in ("aircraft_command", "command_saturation")],
    ),
    noisy_feedback: everything(["load_state"], ["measured_load_state"]),
    FilteredFeedback: (
        ["load_state", "reference"],
        ["measured_load_state", "measured_load_covariance"],
        [(name, "measured_load_state") for name in ("load_state", "reference")],
    ),
    gusty_force: ([], ["disturbance_wrench"], []),
    MultibodyLoadPlant: (["cable_forces", "disturbance_wrench", "load_wind"], ["load_state"], []),
    Cables: (
        ["load_state", "carrier_state"],
        _CABLES,
        [(source, target) for source in ("load_state", "carrier_state") for target in _CABLES],
    ),
    lumped_cables: (
        ["load_state", "carrier_state", "wind", "load_wind"],
        ["cable_state", *_CABLES],
        [
            (source, target)  # one function makes all ends of a cable
            for source in ("load_state", "carrier_state", "wind", "load_wind")
            for target in _CABLES
        ],
    ),
    NoDisturbance: ([], ["disturbance_wrench"], []),
    **dict.fromkeys((StillAir, SteadyWind, rising_wind, gusty_wind), ([], _WINDS, [])),
    KnownWind: everything(["mean_wind"], ["wind_estimate"]),
    NoWind: ([], ["wind_estimate"], []),
    WindObserver: (
        ["wind"],
        ["wind_estimate", "carrier_gust_estimate"],
        [],
    ),
    LoadAnemometer: (
        ["load_wind", "wind"],
        ["wind_estimate", "carrier_gust_estimate"],
        [],
    ),
    LoadPlant: (["cable_forces", "disturbance_wrench", "load_wind"], ["load_state"], []),
}

_MOVED = ("carrier_reference", "carrier_reference_acceleration")
# The outputs that the time of the sample, which a control period adds, feeds through to.
SAMPLED = {
    PaperPhase: ("phase", "planned"),
    **dict.fromkeys((WrenchController, PaperWrenchController, TunedWrenchController), _WRENCH),
    CarrierTrajectory: _MOVED,
    bowed_trajectory: _MOVED,
    first_order_trajectory: _MOVED[:1],
    MeasuredCarrierTrajectory: _MOVED[:1],
    FixedWingController: (),
}
# What the sampled controller of aircraft reads in place of the signals at all times.
AT_SAMPLES = {name: f"sampled_{name}" for name in _MOVED} | {
    name: f"held_{name}" for name in ("carrier_state", "aircraft_state", "carrier_acceleration")
}

# What ends of cables of nodes go by, which are all made by one call.
_ENDS = (
    ("load_state", "cable_forces"),
    ("load_state", "tensions"),
    ("carrier_state", "carrier_cable_forces"),
)

PERIODS = (0.0, 0.01)  # s, of continuous and of sampled controllers


def of_every(blocks):
    """What makes of a test of a block and a control period one of each block, for all periods."""

    def decorated(test):
        @pytest.mark.parametrize("make", blocks, ids=lambda make: make.__name__)
        def over_periods(make):
            for period in PERIODS:
                test(make, period)

        over_periods.__doc__ = test.__doc__
        return over_periods

    return decorated


@functools.cache
def built(make, n, period):
    """A block, which no test changes: what it computes is in the contexts."""
    return make(model(n, period, aircraft=AircraftParameters(model="rascal_110")))


def expected_ports(make, period):
    inputs, outputs, feedthrough = BLOCKS[make]
    if period == 0 or make not in SAMPLED:
        return inputs, outputs, feedthrough
    if make is FixedWingController:
        inputs = [AT_SAMPLES.get(name, name) for name in inputs]
        feedthrough = [(AT_SAMPLES.get(source, source), target) for source, target in feedthrough]
    made = [name for name in _MOVED if name in outputs]  # at samples, and moved in between
    outputs = [*outputs[:3], *(f"sampled_{name}" for name in made), *outputs[3:]]
    feedthrough = [*feedthrough, *((s, f"sampled_{t}") for s, t in feedthrough if t in made)]
    if make is CarrierTrajectory:
        feedthrough = [*feedthrough, *((source, "carrier_reference") for source in _ORBIT)]
    times = [("sample_time", target) for target in SAMPLED[make]]
    return [*inputs, "sample_time"], outputs, [*feedthrough, *times]


def size(signal, n, m):
    """The contract's size, for n carriers and m internal-force coordinates."""
    sizes = {s: k for box in BOXES.values() for s, k in sizes_of(box, n, m).items()}
    own = {"sample_time": 1, "speed_bound_command": 1}
    return (sizes | own)[signal.removeprefix("held_").removeprefix("sampled_")]


def values(signal, seed, n):
    """A value for a signal, such as the loop might have, that differs from seed to seed."""
    signal = signal.removeprefix("held_").removeprefix("sampled_")
    rng = np.random.default_rng([seed, *signal.encode()])
    if signal in ("reference", "load_state", "measured_load_state"):
        return Motion(10 * seed + len(signal)).reference(0.4)[: size(signal, n, n)]
    if signal in ("carrier_state", "carrier_reference"):  # 1.5 m above the load: taut cables
        return rng.uniform(-0.5, 0.5, 6 * n) + np.concatenate([[0, 0, 2.0] * n, np.zeros(3 * n)])
    if signal == "wrench":
        return np.array([0, 0, 0, 0, 0, 10.0]) + rng.uniform(-0.5, 0.5, 6)
    if signal == "desired_cable_forces":
        return rng.uniform(0.5, 2.0, 3 * n)
    if signal == "wind_estimate":  # in which the carriers, at 0.5 m/s, fly as aircraft do
        return np.array([-15.0, 0, 0]) + rng.uniform(0.2, 1.0, 3)
    return rng.uniform(0.2, 1.0, size(signal, n, n))


def input_names(block):
    return [block.get_input_port(i).get_name() for i in range(block.num_input_ports())]


def output_names(block):
    return [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]


@of_every(BLOCKS)
def test_ports_have_the_names_and_sizes_of_the_contract(make, period):
    inputs, outputs, _ = expected_ports(make, period)
    for n in (3, 4):
        block = built(make, n, period)
        assert input_names(block) == inputs
        assert output_names(block) == outputs
        for name in inputs:
            assert block.GetInputPort(name).size() == size(name, n, n), (name, n)
        own = getattr(block, "signal_layouts", {})
        for name in outputs:
            expected = own[name].count(n, n) if name in own else size(name, n, n)
            assert output_sizes(block)[name] == expected, (name, n)


def feedthrough(block):
    """The pairs (input, output) that Drake takes to be connected at once."""
    return {
        (source, target)
        for i, source in enumerate(input_names(block))
        for o, target in enumerate(output_names(block))
        if block.HasDirectFeedthrough(i, o)
    }


@of_every(BLOCKS)
def test_direct_feedthrough(make, period):
    found = feedthrough(built(make, 4, period))
    expected = set(expected_ports(make, period)[2])
    if make is lumped_cables:  # CasADi 3.6 sees through the function of a cable
        assert set(_ENDS) <= found <= expected
    else:
        assert found == expected


def set_states(context, seed):
    """Random states, continuous and discrete."""
    rng = np.random.default_rng(seed)
    count = context.num_continuous_states()
    context.SetContinuousState(rng.uniform(0.2, 1.0, count))
    for i in range(context.num_discrete_state_groups()):
        group = context.get_discrete_state(i)
        context.SetDiscreteState(i, rng.uniform(0.2, 1.0, group.size()))


def evaluated(block, context):
    return {name: output(block, context, name) for name in vector_outputs(block)}


def fresh(block, inputs, state, time):
    """The outputs in a context of its own."""
    context = block.CreateDefaultContext()
    context.SetTime(time)
    set_states(context, state)
    fix(block, context, **inputs)
    return evaluated(block, context)


@of_every(BLOCKS)
def test_outputs_follow_each_change_of_an_input_the_state_and_the_time(make, period):
    block = built(make, 4, period)
    names = input_names(block)
    inputs = {name: values(name, 1, 4) for name in names}
    state, time = 1, 5.5  # a time at which the references move
    context = block.CreateDefaultContext()
    context.SetTime(time)
    set_states(context, state)
    fix(block, context, **inputs)
    before = evaluated(block, context)

    def check(changed):
        after = evaluated(block, context)
        for name, expected in fresh(block, inputs, state, time).items():
            np.testing.assert_array_equal(after[name], expected, err_msg=f"{changed} -> {name}")
        return after

    for name in names:
        inputs[name] = values(name, 2, 4)
        fix(block, context, **{name: inputs[name]})
        check(name)
    state = 2
    set_states(context, state)
    check("state")
    time = 6.25
    context.SetTime(time)
    after = check("time")
    for name in before:
        constant = make in (NoDisturbance, StillAir, SteadyWind, NoWind) or (
            make is ConstantParameters and name == "parameters"
        )
        if name == "reference_higher_rates":  # no snap on a line, nor along cubics
            constant = make in (ConstantVelocityMove, SampledTrajectory)
        if name == "mean_wind":
            constant = make is not rising_wind
        assert np.array_equal(before[name], after[name]) == constant, name


@of_every(BLOCKS)
def test_what_feeds_through_changes_the_output(make, period):
    block = built(make, 4, period)
    inputs = {name: values(name, 1, 4) for name in input_names(block)}
    before = fresh(block, inputs, 1, 5.5)
    for source, target in feedthrough(block):
        if source in ("wind_estimate", "reference_higher_rates") and target not in _DERIVATIVES:
            continue  # made by one call with what it changes; a whole feedforward cancels its rate
        if (make is lumped_cables and (source, target) not in _ENDS) or target == "tracking_error":
            continue  # likewise
        if target == "command_saturation":
            continue  # 0 or 1, whatever most inputs are
        if source == "parameters" and "plan" in inputs:
            continue  # the plan takes their place
        other = np.zeros(1) if source == "sample_time" else values(source, 2, 4)
        after = fresh(block, inputs | {source: other}, 1, 5.5)
        assert not np.array_equal(before[target], after[target]), (source, target)


def made_values(block, scalar, vary):
    """All that the block makes, rates last, where `vary` makes numbers of the scalar type."""
    context = block.CreateDefaultContext()
    context.SetTime(scalar(5.5))
    rng = np.random.default_rng(1)
    context.SetContinuousState(vary(rng.uniform(0.2, 1.0, context.num_continuous_states())))
    for i in range(context.num_discrete_state_groups()):
        size = context.get_discrete_state(i).size()
        context.SetDiscreteState(i, vary(rng.uniform(0.2, 1.0, size)))
    for name in input_names(block):
        block.GetInputPort(name).FixValue(context, vary(values(name, 1, 4)))
    parts = [block.GetOutputPort(name).Eval(context) for name in vector_outputs(block)]
    if context.num_continuous_states() > 0:
        parts.append(block.EvalTimeDerivatives(context).CopyToVector())
    return np.concatenate(parts)


def along(scale):
    """Numbers plus `scale` times a smooth function of them."""
    return lambda given: given + scale * np.sin(7 * given)


@of_every(BLOCKS)
def test_a_clone_makes_the_same_to_the_bit(make, period):
    block = built(make, 4, period)
    expected = made_values(block, float, along(0.0))
    np.testing.assert_array_equal(made_values(block.Clone(), float, along(0.0)), expected)


@pytest.mark.parametrize("n", [3, 6])
@pytest.mark.parametrize("holds_wind", [False, True])
def test_sample_and_hold_passes_nothing_through(n, holds_wind):
    block = SampleAndHold(model(n, 0.01), holds_wind=holds_wind)
    inputs = ["measured_load_state", "reference", "reference_higher_rates"]
    inputs += ["wind_estimate"] if holds_wind else []
    assert input_names(block) == inputs
    assert output_names(block) == [*(f"held_{name}" for name in inputs), "sample_time"]
    for name in output_names(block):
        assert block.GetOutputPort(name).size() == size(name, n, n)
    assert feedthrough(block) == set()


MODULES = [
    importlib.import_module(f"drake_nonstop.blocks.{module.name}")
    for module in pkgutil.iter_modules(blocks.__path__)
]
DOCUMENTED = [block for module in MODULES for block in getattr(module, "VARIANTS", ())]
SECTION = re.compile(r"\.\. pydrake_system::\n\n((?:    .*\n)+)")


@of_every(DOCUMENTED)
def test_the_declared_ports_are_those_that_it_has(block, period):
    made = built(block, 4, period)
    absent = [
        "is false",
        "is true",
        "are not all zero",
        *(["control period"] if period <= 0 else []),
    ]

    def is_there(name):
        return not any(reason in where(block, name) for reason in absent)

    read = [name.removeprefix("sampled_").removeprefix("held_") for name in input_names(made)]
    told = [name.removeprefix("held_") for name in block.reads if is_there(name)]
    if period <= 0:  # what is measured is so at samples
        told = [name for name in told if f"held_{name}" not in block.reads]
    assert read == told
    makes = [name for name in block.makes if is_there(name)]
    assert output_names(made) == [n for n in makes if period > 0 or n != "measured_margin"]


def where(block, name):
    return getattr(block, "where", {}).get(name, "")


@pytest.mark.parametrize("block", DOCUMENTED, ids=lambda block: block.__name__)
def test_docstring_tells_all_that_is_declared(block):
    text = inspect.getdoc(block)
    ports = yaml.safe_load(inspect.cleandoc(SECTION.search(text)[1]))
    assert ports["name"] == block.__name__
    for kind, names in (("input_ports", block.reads), ("output_ports", block.makes)):
        assert [port.partition(" ")[0] for port in ports.get(kind, [])] == list(names)
    for name in (*block.reads, *block.makes):
        (line,) = {line for line in text.splitlines() if line.startswith(f"- `{name}` (")}
        layout = {**LAYOUTS, **SIGNALS, **getattr(block, "signal_layouts", {})}[
            name.removeprefix("held_")
        ]
        size = "abstract" if layout is None else layout.size
        assert line.startswith((f"- `{name}` ({size})", f"- `{name}` ({size}, "))
    fields = parameters(config_class(block))
    assert all(field.meaning for field in fields)
    for field in fields:
        assert f"- `{field.name}`: {field.meaning}" in text.splitlines()
    assert (f"`{config_class(block).__name__}`" in text) == bool(fields)
    assert block.__doc__ in pydoc.render_doc(block, renderer=pydoc.plaintext).replace(
        "\n |  ", "\n"
    )


def test_constructors_are_documented_by_the_package_and_not_by_drake():
    for block in DOCUMENTED:
        assert "`model` and a `config`" in inspect.getdoc(block.__init__), block.__name__
