"""Carriers that must not stop fly a load on cables: the closed loop as Drake systems.

The public names are those of `drake_nonstop.public`. They are imported once one of them is asked
for: a command can answer Ctrl-C before pydrake is imported, which takes a second.
"""

import importlib.util
from typing import TYPE_CHECKING, Any

from drake_nonstop.version import __version__ as __version__

if TYPE_CHECKING:
    from drake_nonstop.public import *  # noqa: F403


_FORMER = {"Wind": "DisturbanceForce", "WindConfig": "DisturbanceForceConfig"}


def __getattr__(name: str) -> Any:
    """A subpackage, a public name, or `__all__`."""
    if not name.startswith("__") or name == "__all__":
        if importlib.util.find_spec(f"{__name__}.{name}") is not None:
            return importlib.import_module(f"{__name__}.{name}")
        public = importlib.import_module(f"{__name__}.public")
        if name in public.__all__ or name == "__all__":
            return globals().setdefault(name, getattr(public, name))
    if name in _FORMER:  # an AttributeError's message is lost in `from drake_nonstop import Wind`
        raise ImportError(f"{__name__}.{name}: {name} is called {_FORMER[name]} now")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__getattr__("__all__")]
