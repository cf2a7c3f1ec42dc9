"""The block that made a value which is not finite is named, not the one that read it."""

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import LeafSystem

from drake_nonstop import RunStopped, load_scenario, simulate


class Faulty(LeafSystem):
    """Makes constant signals; one of them becomes something else after 0.1 s."""

    def __init__(self, signal, fault):
        super().__init__()
        signals = {signal, *ALSO.get(signal, ())}
        for name in sorted(signals):
            value = VALUES[name]

            def calc(context, output, name=name, value=value):
                is_wrong = name == signal and context.get_time() > 0.1
                output.SetFromVector(np.array(value) + (fault if is_wrong else 0.0))

            self.DeclareVectorOutputPort(name, len(value), calc)


VALUES = {
    "disturbance_wrench": np.zeros(6),
    "parameters": [2.0, 1.2],
    "phase": np.zeros(2),
    "planned": [0.0, 2.0, 1.2, *np.zeros(5)],
    "internal_force": np.zeros(8),
    "internal_force_higher_rates": np.zeros(8),
}
# What other blocks read of the one that makes a signal.
ALSO = {
    "phase": ["planned"],
    "planned": ["phase"],
    "internal_force": ["internal_force_higher_rates"],
    "internal_force_higher_rates": ["internal_force"],
}
SIGNALS = [
    ("load_disturbance", "disturbance_wrench", []),
    ("optimization_layer", "parameters", []),
    ("phase", "planned", []),
    ("internal_force", "internal_force", []),
    ("internal_force", "internal_force_higher_rates", []),
]
CASES = [  # the signals with NaN first
    (*signal, fault) for fault in (np.nan, 1e12, np.inf) for signal in SIGNALS
]


@pytest.mark.parametrize(
    ("box", "signal", "settings", "fault"), nightly_beyond(7, "adversary", CASES)
)
def test_the_source_of_a_value_is_named(box, signal, settings, fault):
    overrides = ["simulation_duration=0.2", *settings]
    if box != "optimization_layer":
        overrides.append("optimization_layer=ConstantParameters")
    if box != "load_disturbance":
        overrides.append("load_feedback=DesiredStateFeedback")
    scenario = load_scenario("quintic", overrides)
    with pytest.raises(RunStopped, match=f"diverged at t = 0.1.* s: {box} made a value"):
        simulate(scenario, **{box: lambda model: Faulty(signal, fault)})
