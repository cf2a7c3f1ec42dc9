"""Bad values in every field of two scenarios: a flight, or one sentence, and neither takes long."""

import signal
import warnings

import pytest

from drake_nonstop import RunStopped, ScenarioError, load_scenario, simulate
from drake_nonstop.scenario.overrides import changed, to_tree

VALUES = ["-1", "0", "1e-12", "1e9", "-1e9", ".nan", ".inf", "'5'", "text", "true", "null"]
VALUES += ["[]", "[1, 2]", "{a: 1}"]
LONGEST = 20  # s
SHORT = {
    "quintic": "simulation_duration=0.03",
    "aircraft_transfer_cables": "simulation_duration=0.12",
}


def paths(tree, before=""):
    """The paths of all fields of a tree, parts included."""
    for key, value in tree.items():
        if key != "_tag":
            yield before + key
        if isinstance(value, dict):
            yield from paths(value, f"{before}{key}.")


def complaint(scenario, override):
    """What is wrong with how a value is taken; nothing where it flies, or one sentence is said."""

    def late(*_):
        raise TimeoutError(f"{LONGEST} s have passed")

    signal.signal(signal.SIGALRM, late)
    signal.alarm(LONGEST)
    try:
        simulate(changed(scenario, [override]))
    except (ScenarioError, RunStopped) as error:
        message = str(error)
        is_sentence = "\n" not in message and len(message) < 1500
        return "" if is_sentence else f"{override}: {message}"
    except BaseException as error:
        return f"{override}: {type(error).__name__}: {error}"
    finally:
        signal.alarm(0)
    return ""


@pytest.mark.nightly("adversary")
@pytest.mark.parametrize("name", SHORT)
def test_a_bad_value_of_any_field_is_one_sentence(name):
    scenario = load_scenario(name, [SHORT[name]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        overrides = [f"{path}={value}" for path in paths(to_tree(scenario)) for value in VALUES]
        assert not [*filter(None, (complaint(scenario, override) for override in overrides))]
