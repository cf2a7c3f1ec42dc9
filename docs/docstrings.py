"""How the reference shows docstrings: an extension of Griffe, by which mkdocstrings reads them."""

import importlib
import inspect
import re
from typing import Any

import griffe


class DeclaredPorts(griffe.Extension):
    """Has the reference show what a block's class declares, as `help` does, in lists alone."""

    def on_class_instance(self, *, cls: griffe.Class, **_: Any) -> None:
        """Takes the docstring of the class itself, which is put together when it is asked for."""
        if cls.docstring is None:
            return
        module = importlib.import_module(cls.module.path)
        text = inspect.getdoc(getattr(module, cls.name, None)) or ""
        if ".. pydrake_system::" in text:
            text = re.sub(r"\.\. pydrake_system::\n\n(?: +.*\n)+\n?", "", text)
            # A box's page has a table of the parameters, with their defaults.
            cls.docstring.value = re.sub(r"Parameters, the fields of .*\n\n(?:.+\n?)+", "", text)
