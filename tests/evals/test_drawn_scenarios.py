"""250 drawn scenarios, valid and invalid: a sound run, or one clear sentence."""

import math
from collections import Counter
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.run import RunStopped
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario, scenario_names
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.validation import ScenarioError

loaded = cache(load_scenario)
counts: Counter[str] = Counter()  # of the draws, by how they ended

# Numbers of every kind: sound, odd and impossible.
NUMBERS = st.one_of(
    *[st.floats(0.05, 5.0)] * 3,
    st.floats(-1.0, 50.0),
    st.sampled_from([0.0, -0.0, 1e-12, 1e12, 1e300, -1.0]),
    st.sampled_from([math.nan, math.inf, -math.inf]),
)
WORDS = st.sampled_from(["abc", "true", "[1, 2]", "!IdealFeedback {}", "''", "~", "{}"])
FIELDS = [
    *("system.load_mass", "system.load_drag", "system.load_angular_drag", "system.cable_length"),
    *("system.cable_stiffness", "system.cable_damping", "system.carrier_mass", "system.gravity"),
    *("simulated.load_mass", "simulated.cable_length", "simulated.carrier_mass"),
    *("control_period", "simulator_config.max_step_size", "load_trajectory.move_time"),
    *("wrench_controller.position_gain", "wrench_controller.feedforward"),
    *("optimization_layer.speed_bound", "optimization_layer.tightening"),
    *("optimization_layer.frequency", "optimization_layer.amplitude"),
    *("optimization_layer.period", "optimization_layer.min_tension"),
    *("optimization_layer.max_speed", "optimization_layer.min_separation"),
    *("optimization_layer.smoothing", "optimization_layer.knot_spacing"),
    *("carrier_controller.position_gain", "carrier_controller.velocity_gain"),
    *("scene.wing_span", "scene.mark_range"),
]
SWAPS = st.sampled_from(
    [
        "phase=!PaperPhase {}",
        "optimization_layer=!ConstantParameters {}",
        "load_plant=!MultibodyLoadPlant {}",
        "carrier_dynamics=!LimitedCarriers {max_acceleration: 50, has_weight: true}",
        "load_feedback=!NoisyFeedback {position_noise: 0.01, delay: 0.02}",
        "load_feedback=!NoisyFeedback {delay: 0.005}",
        "load_disturbance=!DisturbanceForce {force: [1, 0, 0], gust_force: 0.5}",
        "load_disturbance=!DisturbanceForce {force: [1, 0]}",
        "optimization_layer.solver=snopt",
        "pattern=SpreadCarousel",
        "load_trajectory=Waypoints",
        "wrench_controller=PaperWrenchController",
        "carrier_controller=FeedforwardCarrierPid",
        "carrier_dynamics=LimitedCarriers",
        "carrier_controller=own.Block",
        "pattern.phases=[0, 1, 2]",
        "system.attachments=[[1, 0, 0], [0, 1, 0], [-1, -1, 0]]",
        "system.attachments=[[1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]]",
        "system.load_inertia=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]",
        "load_plant=!NoSuchPlant {}",
        "no.such.field=1",
    ]
)
SETTINGS = st.one_of(
    *[st.builds("{}={}".format, st.sampled_from(FIELDS), NUMBERS)] * 3,
    st.builds("{}={}".format, st.sampled_from(FIELDS), WORDS),
    SWAPS,
)


@settings(
    max_examples=250,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(
    name=st.sampled_from([name for name in scenario_names() if "_cables" not in name]),
    optimized=st.booleans(),  # the optimizer takes the longest to build
    drawn=st.lists(SETTINGS, min_size=1, max_size=2),
    duration=st.sampled_from([0.03, 0.03, 0.03, 0.1]),
)
def draw_and_run(name, optimized, drawn, duration):
    layer = [] if optimized else ["optimization_layer=ConstantParameters"]
    try:
        scenario = changed(loaded(name), [*layer, f"simulation_duration={duration}", *drawn])
        run = simulate(scenario)
    except ScenarioError as error:
        counts["invalid"] += 1
        message = str(error)
        assert " = " in message
        assert ": " in message
        assert "\n" not in message
        assert len(message) < 600
        return
    except RunStopped as stopped:
        counts["stopped"] += 1
        message = str(stopped)
        assert message.startswith("the run ")
        assert "\n" not in message
        # Its cause is the loop's, not that of a line of ours.
        for kind in (
            "TypeError",
            "IndexError",
            "KeyError",
            "AttributeError",
            "ValueError",
            "LinAlgError",
        ):
            assert kind not in message
        return
    counts["sound"] += 1
    if run.time[-1] < scenario.simulation_duration:
        assert compute_metrics(run)["outcome"] == "stalled"
    for signal, values in run.signals.items():
        assert np.isfinite(values).all(), signal


@pytest.mark.nightly("studies")
def test_nothing_but_a_clear_error_or_a_sound_run():
    counts.clear()
    draw_and_run()
    assert counts["sound"] > 40
    assert counts["invalid"] > 60
