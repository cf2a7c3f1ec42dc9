"""The layouts of the signals: against the views of the same vectors, and what is no layout."""

import numpy as np
import pytest

from drake_nonstop import Diagnostics, ScenarioError
from drake_nonstop.mechanics import signals
from drake_nonstop.mechanics.signal_layouts import Layout, Part, numbered_entries
from drake_nonstop.planning.diagnostics import DIAGNOSTICS

N, M = 5, 3
VIEWS = signals.SignalParts.__subclasses__()
VIEWS += [kind for base in VIEWS for kind in base.__subclasses__()]
LAYOUTS = {view: view.layout for view in VIEWS} | {Diagnostics: DIAGNOSTICS}


@pytest.mark.parametrize("view", LAYOUTS, ids=lambda view: view.__name__)
def test_entries_are_named_by_the_part_that_shows_them(view):
    layout = LAYOUTS[view]
    count = layout.count(N, M)
    entries = layout.entries("signal", count)
    assert len(entries) == len({entry.name for entry in entries}) == count
    for name, numbers in zip(layout.names, view.view(np.arange(count)), strict=True):
        assert {entries[k].name.split(".")[1] for k in np.ravel(numbers)} == {name}


def test_entries_are_numbered_and_sizes_that_do_not_fit_have_none():
    last = signals.CarrierStates.layout.entries("carrier_state", 12)[-1]
    assert last == ("carrier_state.velocities.2.z", "m/s", "W")
    assert [entry.label for entry in numbered_entries("own", 2)] == ["own.1", "own.2"]
    assert signals.LoadState.layout.entries("load_state", 12) is None
    assert signals.CarrierStates.layout.entries("carrier_state", 13) is None
    mixed = Layout(Part("clock", "1", "s"), Part("positions", "3n", "m", "W"))
    assert mixed.size == "1 + 3n"
    assert len(mixed.entries("own", 7)) == 7
    assert mixed.entries("own", 0) is None


UNITS, NAMES = (Part("", "1", None), Part("a", "1", 7)), (Part("a, b", "1"), Part("a\n", "1"))
SINGLE = (Part("a", "2"), Part("a", ""), "a", *UNITS, *NAMES, Part("a", "1", "[m]"))
PAIRS = ((Part("", "1", "kg"), Part("", "1", "kg")), (Part("a", "n"), Part("b", "m")))


@pytest.mark.parametrize("parts", [(), *((part,) for part in SINGLE), *PAIRS])
def test_what_is_no_layout_is_refused(parts):
    with pytest.raises(ScenarioError, match=r"layout = .*give"):
        Layout(*parts)
