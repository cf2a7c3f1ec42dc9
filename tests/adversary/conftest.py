"""The number of examples of a property: a few fixed ones, or COUNT of `make adversary`."""

import os

from hypothesis import HealthCheck, Phase, settings

COUNT = os.environ.get("ADVERSARY_COUNT")
few = {"derandomize": True, "phases": [Phase.explicit, Phase.generate], "max_examples": 12}
many = {"derandomize": False, "print_blob": True, "max_examples": int(COUNT or 0) or 200}
settings.register_profile(
    "adversary",
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
    **(many if COUNT else few),
)
settings.load_profile("adversary")
