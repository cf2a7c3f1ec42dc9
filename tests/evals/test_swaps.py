"""Any block can be swapped alone: the rest stays as it was, and the loop runs."""

import dataclasses
import itertools
from functools import cache

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop import load_scenario, simulate
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.scenario.overrides import changed

PATTERNS = ("HamiltonianCycle", "Carousel", "SpreadCarousel", "EllipticCarousel")
VARIANTS = {name: box.variants for name, box in BOXES.items()}
NAMES = {box: [block.__name__ for block in blocks] for box, blocks in VARIANTS.items()}
EACH = NAMES | {"pattern": PATTERNS}
# Each block swapped for the next of its box, the last for the first; then all others.
NEXT = [
    (box, old, new)
    for box, names in EACH.items()
    for old, new in itertools.pairwise([*names, names[0]])
    if old != new
]
PAIRS = [
    *NEXT,
    *(
        (box, *pair)
        for box, names in EACH.items()
        for pair in itertools.permutations(names, 2)
        if (box, *pair) not in NEXT
    ),
]
AIRCRAFT = ("FixedWingController", "FixedWingDynamics")  # which come in pairs, and need a scale
TURN = ("TurnRateOptimizer", "PlannedTurn")  # of a formation without orbits
ALONE = (*AIRCRAFT, *TURN)  # which do not fly alone
ALTERNATIVES = [
    ("load_feedback", "FilteredFeedback"),
    ("pattern", "EllipticCarousel"),
    *((box, name) for box, names in NAMES.items() for name in names[1:] if name not in ALONE),
    *(("pattern", name) for name in PATTERNS[1:]),
]


@pytest.fixture(scope="module")
def scenario():
    """The quintic task for 2 s, without the optimization, which takes the longest to build."""
    return load_scenario(
        "quintic", ["simulation_duration=2", "optimization_layer=ConstantParameters"]
    )


@pytest.fixture(scope="module")
def with_block(scenario):
    """A function from a box and its block to the scenario with that block."""
    return cache(lambda box, block: changed(scenario, [f"{box}={block}"]))


@pytest.mark.parametrize(("box", "old", "new"), nightly_beyond(len(NEXT), "studies", PAIRS))
def test_swap_changes_nothing_but_the_box(scenario, with_block, box, old, new):
    before = with_block(box, old)
    after = changed(before, [f"{box}={new}"])
    assert type(getattr(after, box)).__name__ == f"{new}Config"
    for field in dataclasses.fields(scenario):
        if field.name not in (box, "simulator_config"):
            assert getattr(after, field.name) == getattr(before, field.name), field.name
    for field in SimulatorConfig.__fields__:
        values = [getattr(each.simulator_config, field.name) for each in (before, after)]
        assert values[0] == values[1], field.name


@pytest.mark.parametrize(
    ("box", "block"), nightly_beyond(2, "flights", dict.fromkeys(ALTERNATIVES))
)
def test_swapped_loop_runs(with_block, box, block):
    scenario = with_block(box, block)
    if block == "MeasuredCarrierTrajectory":  # which makes no accelerations to be fed forward
        scenario = changed(scenario, ["carrier_controller=CarrierPid"])
    run = simulate(scenario)
    assert run.time[-1] == pytest.approx(2)
    for name, values in run.signals.items():
        assert np.all(np.isfinite(values)), name
    assert np.linalg.norm(run.signal("load_state")[-1, 4:7]) < 2
    if box in BOXES:
        assert type(run.diagram.GetSubsystemByName(box)).__name__ == block


@pytest.mark.nightly("flights")
def test_aircraft_are_swapped_for_points_and_back():
    aircraft = load_scenario("aircraft_rest", ["simulation_duration=2"])
    boxes = ("carrier_controller", "carrier_dynamics")
    points = changed(aircraft, [f"{box}={NAMES[box][0]}" for box in boxes])
    assert "aircraft_state" not in simulate(points).signals
    again = changed(points, [f"{box}={name}" for box, name in zip(boxes, AIRCRAFT, strict=True)])
    again.carrier_controller.frequency = aircraft.carrier_controller.frequency
    np.testing.assert_array_equal(
        simulate(again).signal("aircraft_state"), simulate(aircraft).signal("aircraft_state")
    )
