"""Any value of a scene's fields is refused before a run, or can be shown after it."""

import dataclasses

import pytest
from helpers import circling_run, nightly_beyond
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import ScenarioError, require_ranges
from drake_nonstop.view.replay import record_replay

_COLOURS = st.one_of(st.just("#0a4fff"), st.text(max_size=8), st.integers(), st.none())
_NUMBERS = st.one_of(
    st.floats(), st.sampled_from([0, 1, -1, 1e-320, 1e300, 0.5]), st.booleans(), st.text(max_size=2)
)
_KINDS = {
    str: _COLOURS,
    float: _NUMBERS,
    int: st.one_of(st.integers(-2, 50), st.booleans(), st.floats(0, 5)),
    list[str]: st.one_of(st.lists(_COLOURS, max_size=4), _COLOURS),
}


@pytest.mark.parametrize("count", nightly_beyond(1, "adversary", [12, 100]))
def test_what_is_not_refused_can_be_shown(count):
    given_values = given(data=st.data())(is_refused_or_shown)
    limits = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
    settings(max_examples=count, **limits)(given_values)()


def is_refused_or_shown(data):
    """Two fields at a time, of any value: the replay of a run that has been flown is written."""
    fields = {field.name: field.type for field in dataclasses.fields(SceneConfig)}
    names = data.draw(st.lists(st.sampled_from([*fields]), min_size=1, max_size=2, unique=True))
    config = SceneConfig(**{name: data.draw(_KINDS[fields[name]]) for name in names})
    run = circling_run(n=3, duration=0.05)
    run.scenario.scene = config
    try:
        require_ranges("scene", config)
    except ScenarioError as error:
        assert str(error).startswith("scene.")  # noqa: PT017
        with pytest.raises(ScenarioError, match=r"^scene\."):
            simulate(run.scenario)  # before it looks at anything else
    else:
        assert "<html" in record_replay(run)
