"""What blocks of a loop say of each other."""

import pytest

from drake_nonstop.blocks.load_disturbance import NoDisturbance
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError, ScenarioWarning


class Careful(NoDisturbance):
    """Wants a load of 2 kg, and tells of all cables."""

    def requires(self, loop):
        if loop.simulated.load_mass < 2:
            raise ScenarioError(f"simulated.load_mass = {loop.simulated.load_mass:g}: give 2")
        yield f"cables = {type(loop.get('cables')).__name__}: they are light"


def test_a_block_of_ones_own_tells_what_it_requires():
    with pytest.raises(ScenarioError, match=r"^simulated\.load_mass = 1: give 2$"):
        make_nonstop(Scenario(), load_disturbance=Careful)
    scenario = Scenario()
    scenario.system.load_mass = 2.0
    with pytest.warns(ScenarioWarning, match=r"^cables = Cables: they are light") as told:
        make_nonstop(scenario, at_equilibrium=False, load_disturbance=Careful)
    assert [warning.filename for warning in told] == [__file__]  # the user's line
