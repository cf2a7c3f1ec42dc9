"""What a block's events and outputs have to be for a compiled loop, and how others are named."""

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from drake_nonstop.loop.block_events import (
    NotCompilableError,
    SteppedBlock,
    sample_times,
    timing_complaint,
)

PERIOD = 0.01  # s


class Counter(LeafSystem):
    """Counts its updates, and has the events that are given as names and timings."""

    def __init__(self, *events):
        super().__init__()
        self.set_name("counter")
        state = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("count", state)
        for name, *timing in events:
            act = self.nothing if "Publish" in name else self.add
            getattr(self, f"Declare{name}Event")(*timing, act)

    def add(self, context, state):
        values = (
            state.get_mutable_discrete_state() if hasattr(state, "get_discrete_state") else state
        )
        values.set_value(context.get_discrete_state_vector().CopyToVector() + 1)

    def nothing(self, context):
        pass


def flown(block, samples=20):
    """The counts after each sample."""
    stepped = SteppedBlock(block, block.CreateDefaultContext())
    stepped.start()
    counts = [stepped.context.get_discrete_state_vector()[0]]
    for time in sample_times(np.arange(1, samples + 1), PERIOD).tolist():
        stepped.advance_to(time)
        stepped.update()
        counts.append(stepped.context.get_discrete_state_vector()[0])
    return counts


@pytest.mark.parametrize(
    ("timing", "fits"),
    [
        ((PERIOD, PERIOD), True),
        ((2 * PERIOD, PERIOD), True),
        ((PERIOD, 0.0), False),  # as `period * k`, which is not `period + period * (k - 1)`
        ((2 * PERIOD, 2 * PERIOD), False),
        ((3 * PERIOD, PERIOD), False),
        ((0.007, PERIOD), False),
        ((PERIOD, 0.003), False),
    ],
)
def test_updates_have_to_be_at_samples_to_the_bit(timing, fits):
    block = Counter(("PeriodicDiscreteUpdate", *timing))
    complaint = timing_complaint(block, PERIOD)
    assert (complaint == "") == fits
    if not fits:
        assert f"every {timing[0]:g} s from t = {timing[1]:g} s on" in complaint
    at_each = timing_complaint(block, PERIOD, at_each=True)
    assert (at_each == "") == (timing == (PERIOD, PERIOD))


def test_updates_at_samples_are_made():
    start = ("InitializationDiscreteUpdate",)
    each, second = (
        ("PeriodicDiscreteUpdate", PERIOD, PERIOD),
        ("PeriodicDiscreteUpdate", 0.02, PERIOD),
    )
    assert flown(Counter(each), 4) == [0, 1, 2, 3, 4]
    assert flown(Counter(start, second), 4) == [1, 2, 2, 3, 3]


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (("PeriodicDiscreteUpdate", PERIOD, 0.0), "a discrete update at t = 0 or at each step"),
        (
            ("PeriodicDiscreteUpdate", 0.07, 0.153),
            "a discrete update before the sample at t = 0.16",
        ),
        (("PeriodicUnrestrictedUpdate", PERIOD, PERIOD), "an unrestricted update at t = 0.01 s"),
        (("PeriodicPublish", 0.05, 0.15), "a publish event before the sample at t = 0.15 s"),
        (("PerStepDiscreteUpdate",), "a discrete update at t = 0 or at each step"),
        (("PerStepUnrestrictedUpdate",), "an unrestricted update at t = 0 or at each step"),
        (("PerStepPublish",), "a publish event at the start"),
        (("InitializationUnrestrictedUpdate",), "an unrestricted update at the start"),
        (("InitializationPublish",), "a publish event at the start"),
    ],
)
def test_other_events_are_named_when_they_come(event, said):
    with pytest.raises(NotCompilableError, match=f"^counter = Counter: it has {said}"):
        flown(Counter(("PeriodicDiscreteUpdate", PERIOD, PERIOD), event))


class Shown(LeafSystem):
    """Shows a function of the time, and declares that it depends on something else."""

    def __init__(self, value, ticket):
        super().__init__()
        self.set_name("shown")
        self.value = value
        self.DeclareDiscreteState(1)
        self.DeclareVectorOutputPort("out", 1, self.calc, {ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, lambda context, state: None)

    def calc(self, context, output):
        output.SetFromVector([self.value(context.get_time())])


@pytest.mark.parametrize(
    ("value", "ticket", "said"),
    [
        (lambda time: time, Shown.xd_ticket, "out changes without an update before t = 0.01 s"),
        (lambda time: time > 0.155, Shown.nothing_ticket, "out changes .* before t = 0.16 s"),
        (lambda time: 1.0, Shown.time_ticket, "out depends on the time"),
    ],
)
def test_an_output_that_changes_by_itself_is_named(value, ticket, said):
    with pytest.raises(NotCompilableError, match=f"^shown = Shown: {said}"):
        flown(Shown(value, ticket))
