"""The numbers of a loop that has been built, taken from another scenario's models and configs."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.loop.parameters import Holder, holders_in
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import title
from drake_nonstop.systems.diagram_trace import TAKE_CONFIG


@dataclasses.dataclass(frozen=True)
class LoopNumbers:
    """All that a loop is built from in numbers.

    Attributes:
        models: of the controllers and the plant, by the names "system" and "simulated".
        configs: of the blocks, by the names of their boxes.
    """

    models: Mapping[str, Model]
    configs: Mapping[str, Any]


def take_numbers(loop: Diagram, context: Context, built: LoopNumbers, taken: LoopNumbers) -> bool:
    """Sets what a loop's context has of the numbers that it was `built` with to others.

    False where the loop would be built in another way, or a block would keep what it was built
    with: the context is of no use then.

    Args:
        loop: whose blocks all are the package's.
        context: a new one of the loop.
        built: the numbers that it has in a new context.
        taken: those that it gets, for the same pattern.

    Raises:
        ScenarioError: a block cannot be made with them.
    """
    changes = {box: _changed(built.configs[box], new) for box, new in taken.configs.items()}
    if None in changes.values() or not _is_one_geometry(built, taken):
        return False
    for block in loop.GetSystems():
        if hasattr(block, TAKE_CONFIG) and changes.get(title(block)):
            own = loop.GetMutableSubsystemContext(block, context)
            getattr(block, TAKE_CONFIG)(own, taken.configs[title(block)])
            del changes[title(block)]
    for holder in holders_in(loop):
        changed = changes.pop(holder.box, None) or {}
        if not _write(holder, loop, context, taken.models[holder.role], changed):
            return False
    return not any(changes.values())


def _changed(old: Any, new: Any) -> dict[str, Any] | None:
    """The fields of a new config that differ from the old one's; None: it is of another class."""
    if type(old) is not type(new) or not dataclasses.is_dataclass(old):
        return {} if old is new else None
    pairs = ((f.name, getattr(old, f.name), getattr(new, f.name)) for f in dataclasses.fields(old))
    return {name: value for name, before, value in pairs if not _is_same(before, value)}


def _is_same(one: Any, other: Any) -> bool:
    try:
        return bool(one == other)
    except ValueError:  # arrays
        return False


def _is_one_geometry(built: LoopNumbers, taken: LoopNumbers) -> bool:
    """Whether the models differ in fields that blocks may have as parameters alone."""
    return all(
        _is_same(old.system.aircraft, taken.models[role].system.aircraft)
        and _is_same(old.system.attachments, taken.models[role].system.attachments)
        for role, old in built.models.items()
    )


def _write(
    holder: Holder, loop: Diagram, context: Context, model: Model, changed: dict[str, Any]
) -> bool:
    """Sets a block's parameters; False where it would be built in another way."""
    old = holder.parameters
    if not changed and _is_same(model.system, old.model.system):
        return True
    is_kept = any(not np.array_equal(model.number(k), old.model.number(k)) for k in old.fixed)
    if is_kept or not changed.keys() <= {*old.own}:
        return False
    config = dataclasses.replace(old.config, **changed) if changed else old.config
    old.check(model, config)
    new = old.with_numbers(model, config)
    if old.structure(old.model, old.config) != old.structure(model, config):
        return False
    is_like = [v.shape for v in old.defaults.values()] == [v.shape for v in new.defaults.values()]
    if not is_like or not np.array_equal(np.isfinite(old.vector), np.isfinite(new.vector)):
        return False
    if holder.group is not None:
        context.get_mutable_numeric_parameter(holder.group).SetFromVector(new.vector)
        if hasattr(holder.block, "begin_anew"):
            holder.block.begin_anew(loop.GetMutableSubsystemContext(holder.block, context))
    return True
