"""How the reference shows docstrings: an extension of Griffe, by which mkdocstrings reads them."""

import inspect
import re
from typing import Any

import griffe
import yaml


class PortsInWords(griffe.Extension):
    """Has the reference tell in words what Drake's directive tells of a block's ports."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Changes a docstring that has the directive."""
        if obj.docstring is not None:
            text = obj.docstring.value
            obj.docstring.value = re.sub(
                r"\.\. pydrake_system::\n\n((?: +.*\n?)+)", _ports_in_words, text
            )


def _ports_in_words(directive: re.Match[str]) -> str:
    ports = yaml.safe_load(inspect.cleandoc(directive[1]))
    texts = []
    for word, kind in (("Reads", "input_ports"), ("makes", "output_ports")):
        if ports.get(kind):
            names = (re.sub(r"<[^>]*>", "", str(name)) for name in ports[kind])
            texts.append(f"{word} {', '.join(f'`{name}`' for name in names)}")
    text = "; ".join(texts)
    return f"{text[:1].upper()}{text[1:]}.\n" if text else ""
