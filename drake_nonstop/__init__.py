"""Carriers that must not stop fly a load on cables: the closed loop as Drake systems.

The public names are those of `drake_nonstop.public`. They are imported once one of them is asked
for: a command can answer Ctrl-C before pydrake is imported, which takes a second.
"""

import importlib
from typing import TYPE_CHECKING, Any

from drake_nonstop.version import __version__ as __version__

if TYPE_CHECKING:
    from drake_nonstop.public import *


def __getattr__(name: str) -> Any:
    """A public name, `__all__`, or a subpackage that these have imported."""
    if not name.startswith("__") or name == "__all__":
        public = importlib.import_module("drake_nonstop.public")
        if name in public.__all__ or name == "__all__":
            return getattr(public, name)
        if name in globals():
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__getattr__("__all__")]
