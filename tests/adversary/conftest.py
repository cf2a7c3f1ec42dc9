"""The number of examples of a property: a few fixed ones, or COUNT of `make adversary`."""

import os

from hypothesis import HealthCheck, Phase, settings

settings.register_profile(
    "few",
    max_examples=12,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
settings.register_profile(
    "many",
    settings.get_profile("few"),
    max_examples=int(os.environ.get("ADVERSARY_COUNT", "200")),
    derandomize=False,
    phases=[*Phase],
    print_blob=True,
)
settings.load_profile("many" if "ADVERSARY_COUNT" in os.environ else "few")
