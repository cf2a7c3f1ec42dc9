"""Carriers that must not stop fly a load on cables: the closed loop as Drake systems.

The public names are those of `drake_nonstop.public`. A name's module is imported once the name is
asked for, so that a command or a script waits for no more of Drake than it needs.
"""

import functools
import importlib
import os
import re
from typing import TYPE_CHECKING, Any

from drake_nonstop.version import __version__ as __version__

if TYPE_CHECKING:
    from drake_nonstop.public import *  # noqa: F403
else:  # what type checkers must not see: with it any name would do

    @functools.cache
    def _modules() -> dict[str, str]:
        """The module of each public name."""
        with open(os.path.join(os.path.dirname(__file__), "public.py"), encoding="utf-8") as file:
            imports = re.findall(r"(?m)^from (\S+) import (\([^)]*\)|.*)", file.read())
        return {
            name: module for module, names in imports for name in re.findall(r" as (\w+)", names)
        }

    def __getattr__(name: str) -> Any:
        """A public name, `__all__`, or a subpackage."""
        if name == "__all__":
            return [*_modules(), "__version__"]
        if name in _modules():
            found = getattr(importlib.import_module(_modules()[name]), name)
            return globals().setdefault(name, found)
        try:
            return importlib.import_module(f"{__name__}.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"{__name__}.{name}":
                raise
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return [*globals(), *__getattr__("__all__")]
