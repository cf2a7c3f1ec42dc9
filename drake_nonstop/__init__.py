"""Carriers that must not stop fly a load on cables: the closed loop as Drake systems.

The public names are those of `drake_nonstop.public`. They are imported once one of them is asked
for: a command can answer Ctrl-C before pydrake is imported, which takes a second.
"""

import importlib.util
from typing import TYPE_CHECKING, Any

from drake_nonstop.version import __version__ as __version__

_FORMER = {
    "NonstopOptimizer": "PaperLayer",
    "NonstopOptimizerConfig": "PaperLayerConfig",
    "Wind": "DisturbanceForce",
    "WindConfig": "DisturbanceForceConfig",
}

if TYPE_CHECKING:
    from drake_nonstop.public import *  # noqa: F403
else:  # what type checkers must not see: with it any name would do

    def __getattr__(name: str) -> Any:
        """A subpackage, a public name, or `__all__`."""
        if not name.startswith("_") or name == "__all__":
            if importlib.util.find_spec(f"{__name__}.{name}") is not None:
                return importlib.import_module(f"{__name__}.{name}")
            public = vars(importlib.import_module(f"{__name__}.public"))
            names = {key: value for key, value in public.items() if not key.startswith("_")}
            found = {"__all__": [*names, "__version__"], **names}
            if name in found:
                return globals().setdefault(name, found[name])
        if name in _FORMER:  # `from drake_nonstop import` loses an AttributeError's message
            raise ImportError(f"{__name__}.{name}: {name} is called {_FORMER[name]} now")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        own = globals().keys() - {"Any", "TYPE_CHECKING", "importlib"}
        return [*own, *__getattr__("__all__")]
