"""Carriers that must not stop fly a load on cables: the closed loop as Drake systems.

The public names are those of `drake_nonstop.public`. A name's module is imported once the name is
asked for, so that a command or a script waits for no more of Drake than it needs.
"""

import ast
import functools
import importlib
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drake_nonstop.version import __version__ as __version__

if TYPE_CHECKING:
    from drake_nonstop.public import *  # noqa: F403
else:  # what type checkers must not see: with it any name would do

    @functools.cache
    def _modules() -> dict[str, str]:
        """The module of each public name."""
        tree = ast.parse(Path(__file__).with_name("public.py").read_text(encoding="utf-8"))
        imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
        return {alias.name: node.module for node in imports for alias in node.names}

    def __getattr__(name: str) -> Any:
        """A public name, `__all__`, or a subpackage."""
        if name == "__all__":
            return [*_modules(), "__version__"]
        if name in _modules():
            found = getattr(importlib.import_module(_modules()[name]), name)
            if "IPython" in sys.modules:  # which shows runs and scenarios by tables and pictures
                importlib.import_module(f"{__name__}.view.rich_display")
            return globals().setdefault(name, found)
        if not name.startswith("_") and importlib.util.find_spec(f"{__name__}.{name}") is not None:
            return importlib.import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return [*globals(), *__getattr__("__all__")]
