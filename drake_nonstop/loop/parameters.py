"""Parameters of a loop by their scenario paths: set in all blocks that go by them, in one call.

`system.load_mass` is what the controllers believe, and what the plant has unless `simulated` says
otherwise; `simulated.load_mass` is the plant's alone; `pattern.spread` belongs to the pattern, and
`wrench_controller.position_gain` to the block in that box.
"""

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import Context, Context_, Diagram, System

from drake_nonstop.loop.equilibrium import LOOP_SIGNALS
from drake_nonstop.model.aircraft import AircraftParameters, values_of
from drake_nonstop.model.block import AUTO, BlockParameters
from drake_nonstop.model.pattern import InternalForcePattern
from drake_nonstop.model.system import AIRCRAFT, OFFSET, Model, SystemParameters
from drake_nonstop.systems.block import is_converted, title
from drake_nonstop.systems.documentation import meanings
from drake_nonstop.systems.parameters import declared
from drake_nonstop.systems.wiring import innermost, ports_of, require_own_context
from drake_nonstop.validation import require, require_array, require_known, require_type

_SYSTEM, _SIMULATED, _PATTERN = "system", "simulated", "pattern"
_SPREAD = "spread"  # a field of a pattern, which its offset is proportional to
_FIELDS = {field.name: field.type for field in dataclasses.fields(SystemParameters)} | {
    AIRCRAFT + field.name: field.type for field in dataclasses.fields(AircraftParameters)
}
_MASS = f"{AIRCRAFT}mass"  # which the carriers' is
_GEOMETRY = ("attachments", "load_file", "attachment_frames", "aircraft", f"{AIRCRAFT}model")
_BUILD = "build the loop with this value"


@dataclass(frozen=True, kw_only=True)
class LoopParameter:
    """A parameter of a loop's context.

    Attributes:
        path: its scenario path; a block without a name goes by its class.
        value: a number, or an array in the shape of the scenario's list.
        meaning: its unit and what it is.
        blocks: the names of the blocks that go by it.
    """

    path: str
    value: float | NDArray
    meaning: str
    blocks: tuple[str, ...]


@dataclass(frozen=True)
class Holder:
    """Parameters of a block: their place in the loop's context, or None where they are kept."""

    box: str
    block: System
    parameters: BlockParameters
    group: int | None

    @property
    def role(self) -> str:
        """Name of its model in a scenario."""
        return self.parameters.model.field

    def goes_by(self, field: str) -> bool:
        """Whether a field of the system, or `OFFSET`, is a parameter, or what it was built with."""
        return field in self.parameters.of_system or field in self.parameters.fixed


def parameters(loop: Diagram, context: Context) -> list[LoopParameter]:
    """The parameters of a loop, with their values in its context.

    Args:
        loop: as of `make_nonstop`, or any diagram of its blocks, or one around it; before a
            conversion.
        context: the loop's own, in a bigger diagram `loop.GetMyContextFromRoot(root)`; also that
            of the loop converted to AutoDiffXd.

    Raises:
        ScenarioError: the context is not the loop's, or the loop is a converted one.
    """
    return _Loop(loop, context).listed()


def get_parameter(loop: Diagram, context: Context, path: str) -> float | NDArray:
    """The value of a parameter in a context, see `parameters` and `set_parameter`.

    Raises:
        ScenarioError: there is none of that path, or the context is not the loop's.
    """
    _require_path(path)
    found = {entry.path: entry.value for entry in parameters(loop, context)}
    require_known(path, list(found), "parameter", path)
    return found[path]


def set_parameter(loop: Diagram, context: Context, path: str, value: Any) -> None:
    """Sets a parameter of a loop in all blocks that go by it, without building or tracing anew.

    With `system.<field>` the plant follows unless the scenario's `simulated` gives the field, or
    the plant has another value by now; with `simulated.<field>` the plant is set alone. What is
    "auto" in a block's config follows, too, unless it has another value by now. The state
    stays: for another mass or cable `set_equilibrium` finds the start anew. An optimization layer
    that has not been updated yet begins with the values set.

    Loop and context are as of `parameters`; in that of the loop converted to AutoDiffXd a value may
    have derivatives. Path and value are as in a scenario, such as "system.load_mass".

    Raises:
        ScenarioError: there is no such parameter, the value is out of its range, a block that goes
            by it keeps what it was built with, or the loop would be built in another way with
            it. Nothing is set then.
    """
    _Loop(loop, context).set(path, value)


class _Loop:
    """A loop with a context."""

    def __init__(self, loop: Diagram, context: Context):
        loop, context = _innermost(loop, context)
        self._loop, self._context = loop, context
        self._holders = [*holders_in(loop)]

    def listed(self) -> list[LoopParameter]:
        """The parameters, each once."""
        found: dict[str, LoopParameter] = {}
        for holder in self._holders:
            if holder.group is None:
                continue
            for path, value, meaning in self._entries(holder):
                boxes = found[path].blocks if path in found else ()
                value = found[path].value if path in found else value
                boxes += (holder.box,) if holder.box not in boxes else ()
                found[path] = LoopParameter(path=path, value=value, meaning=meaning, blocks=boxes)
        return list(found.values())

    def _entries(self, holder: Holder) -> Iterator[tuple[str, Any, str]]:
        """The paths that set it, with its values and their meanings."""
        parameters = holder.parameters
        for name in parameters.of_system:
            value = self._value(holder, name)
            if name == OFFSET:
                yield f"{_PATTERN}.offset", value, "N, in L, 3 for each cable"
                config = parameters.model.pattern_config
                if hasattr(config, _SPREAD):
                    about = meanings(type(config))[_SPREAD]
                    yield f"{_PATTERN}.{_SPREAD}", _spread_of(parameters.model, value), about
                continue
            kind = AircraftParameters if name.startswith(AIRCRAFT) else SystemParameters
            about = meanings(kind).get(name.removeprefix(AIRCRAFT), "")
            yield f"{holder.role}.{name}", value, about
            if holder.role == _SIMULATED and self._follows(name):
                yield f"{_SYSTEM}.{name}", value, about
        for name in parameters.own:
            about = meanings(type(parameters.config)).get(name, "")
            yield f"{holder.box}.{name}", self._value(holder, name), about

    def set(self, path: str, value: Any) -> None:
        """Sets a parameter, see `set_parameter`."""
        _require_path(path)
        is_converted_one = isinstance(self._context, Context_[AutoDiffXd])
        remedy = "give a number, or a context of the loop converted to AutoDiffXd"
        require(is_converted_one or not _has_derivatives(value), path, value, remedy)
        scope, _, field = path.partition(".")
        boxes = [title(block) for block in self._loop.GetSystems()]
        boxes += [holder.box for holder in self._holders if holder.box not in boxes]
        require_known(scope, [_SYSTEM, _SIMULATED, _PATTERN, *boxes], "parameter", path)
        models = self._changed_models(scope, field, path, value)
        name = OFFSET if scope == _PATTERN else field
        writes: list[tuple[Holder, Any]] = []
        for holder in self._holders:
            changed = models.get(holder.role)
            is_own = scope == holder.box and field in holder.parameters.own
            if changed is None and not is_own:
                continue
            is_written = is_own or (changed is not None and holder.goes_by(name))
            new = self._checked(holder, changed, {field: _plain(value)} if is_own else {}, path)
            if is_written:
                self._require_following(holder, name, path, value)
                self._require_effect(holder, name, value)
                writes.append((holder, new if changed is not None and name == OFFSET else value))
        self._require_unread(models, name, path, value)
        if field == _MASS:
            self._require_no_other_mass(models, path, value)
        known = sorted(entry.path for entry in self.listed() if entry.path.startswith(f"{scope}."))
        is_of_system = scope in (_SYSTEM, _SIMULATED)
        there = f"it is no parameter of the context, which has {', '.join(known) or 'none'} here"
        remedy = "no block of the loop goes by it" if is_of_system else f"{there}; {_BUILD}"
        require(bool(writes), path, value, remedy)
        for holder, new in writes:
            can_lead = name in holder.parameters.of_system
            following = self._following(holder) if can_lead else []
            self._write(holder, name, new)
            found = holder.parameters.follow(self._numbers(holder))
            for own in following:
                self._write(holder, own, found[own])
        self._begin_anew({holder.box: holder.block for holder, _ in writes})

    def _changed_models(self, scope: str, field: str, path: str, value: Any) -> dict[str, Model]:
        """The models with the value, by their roles."""
        if scope in (_SYSTEM, _SIMULATED):
            require_known(field, list(_FIELDS), "parameter", path)
            remedy = f"it is fixed as the loop is built; {_BUILD}"
            require(field not in _GEOMETRY, path, value, remedy)
            require_type(path, _plain(value), _FIELDS[field])
            roles = [scope]
            if scope == _SYSTEM and self._follows(field):
                roles.append(_SIMULATED)
            found = {role: self._model(role, **{field: _plain(value)}) for role in roles}
            return {role: model for role, model in found.items() if model is not None}
        models: dict[str, Model] = {}
        if scope == _PATTERN and any(holder.goes_by(OFFSET) for holder in self._holders):
            for role in {holder.role for holder in self._holders}:
                model = self._model(role, **{OFFSET: self._offset(field, path, value)})
                models |= {role: model} if model is not None else {}
        return models

    def _offset(self, field: str, path: str, value: Any) -> NDArray:
        """The offset (3n,) that a field of the pattern gives."""
        model = self._holders[0].parameters.model
        if field == "offset":
            return require_array(path, _plain(value), [3 * model.n], "N, in L, 3 per cable")
        config: Any = model.pattern_config
        is_spread = field == _SPREAD and hasattr(config, _SPREAD)
        require(is_spread, path, value, f"it is fixed as the loop is built; {_BUILD}")
        require_type(path, _plain(value), float)
        return dataclasses.replace(config, spread=_plain(value)).make(model.attachments).offset

    def _checked(
        self, holder: Holder, changed: Model | None, own: dict[str, Any], path: str
    ) -> Any:
        """Raises ScenarioError where the block cannot be so; returns the pattern's offset."""
        parameters = holder.parameters
        model = changed or self._model(holder.role) or parameters.model
        config = parameters.config
        if parameters.own:
            following = self._following(holder)
            present = {
                name: AUTO if name in following else self._value(holder, name)
                for name in parameters.own
            }
            for name, plain in own.items():
                kind = {f.name: f.type for f in dataclasses.fields(config)}[name]
                require_type(path, plain, kind)
                shape = parameters.defaults[name].shape
                require_array(path, plain, shape, meanings(type(config)).get(name, ""))
            config = dataclasses.replace(config, **(present | own))
        parameters.check(model, config)
        value = [*own.values()] or [getattr(model.system, path.partition(".")[2], None)]
        require(
            parameters.structure(model, config)
            == parameters.structure(parameters.model, parameters.config),
            path,
            value[0],
            f"{holder.box} = {type(holder.block).__name__} is built in another way for it, with "
            f"other states or signals; {_BUILD}",
        )
        return model.pattern.offset

    def _require_following(self, holder: Holder, name: str, path: str, value: Any) -> None:
        is_kept = holder.group is None or name in holder.parameters.fixed
        block = f"{holder.box} = {type(holder.block).__name__}"
        require(not is_kept, path, value, f"{block} keeps what it was built with; {_BUILD}")

    def _require_effect(self, holder: Holder, name: str, value: Any) -> None:
        """Raises ScenarioError where a signal that the block reads takes the parameter's place."""
        require_effect = getattr(holder.block, "require_effect", None)
        if require_effect is not None and isinstance(self._context, Context):
            context = self._loop.GetSubsystemContext(holder.block, self._context)
            require_effect(context, name, value)

    def _require_no_other_mass(self, models: dict[str, Model], path: str, value: Any) -> None:
        """Raises ScenarioError where a block goes by the carriers' mass, which is the aircraft's.

        A block of aircraft goes by the aircraft's itself.
        """
        for holder in self._holders:
            goes_by = holder.role in models and holder.goes_by("carrier_mass")
            block = f"{holder.box} = {type(holder.block).__name__}"
            require(not goes_by, path, value, f"{block} is for carriers of a given mass; {_BUILD}")

    def _require_unread(self, models: dict[str, Model], name: str, path: str, value: Any) -> None:
        """Raises ScenarioError where a block of the user's own has read the field."""
        for box, watched in getattr(self._loop, "watched_models", {}).items():
            follows = any(h.box == box and h.goes_by(name) for h in self._holders)
            require(
                watched.field not in models or name not in watched.read or follows,
                path,
                value,
                f"{box} has read it from its model and keeps it; {_BUILD}",
            )

    def _model(self, role: str, **changes: Any) -> Model | None:
        """The checked model of that role with the context's parameters, and with the changes."""
        holders = [holder for holder in self._holders if holder.role == role]
        if not holders:
            return None
        built = holders[0].parameters.model
        numbers = {
            name: self._value(holder, name)
            for holder in holders
            for name in holder.parameters.of_system
        } | changes
        offset = np.array(numbers.pop(OFFSET, built.pattern.offset))
        own = {k: numbers.pop(k) for k in [*numbers] if k.startswith(AIRCRAFT)}
        system = dataclasses.replace(built.system, **numbers)
        if own and system.aircraft is not None:
            given = values_of(system.aircraft) | {
                k.removeprefix(AIRCRAFT): v for k, v in own.items()
            }
            if given != values_of(system.aircraft):
                mass = own.get(_MASS, system.carrier_mass)
                aircraft = AircraftParameters(**given)
                system = dataclasses.replace(system, aircraft=aircraft, carrier_mass=mass)
        if system == built.system and np.array_equal(offset, built.pattern.offset):
            return built
        pattern = dataclasses.replace(built.pattern, offset=offset)
        return Model(
            system,
            _GivenPattern(pattern),
            built.control_period,
            field=built.field,
            overridden=built.overridden,
        )

    def _follows(self, field: str) -> bool:
        """Whether the plant has what the controllers believe of a field."""
        values: dict[str, list[Any]] = {_SYSTEM: [], _SIMULATED: []}
        for holder in self._holders:
            if holder.role == _SIMULATED and field in holder.parameters.model.overridden:
                return False
            if field in holder.parameters.of_system:
                values[holder.role].append(self._value(holder, field))
        pairs = ((a, b) for a in values[_SYSTEM][:1] for b in values[_SIMULATED])
        return all(a == b for a, b in pairs)

    def _following(self, holder: Holder) -> list[str]:
        """The fields of the config that are "auto", but for those set to another value since."""
        parameters = holder.parameters
        numbers = self._numbers(holder)
        found = parameters.follow(numbers)
        return [
            name
            for name in parameters.own
            if parameters.is_auto(name) and _are_same(found[name], numbers[name])
        ]

    def _numbers(self, holder: Holder) -> dict[str, NDArray]:
        """All parameters of a block by name, with derivatives where the context has them."""
        vector = holder.parameters.vector
        if holder.group is not None:
            vector = self._context.get_numeric_parameter(holder.group).CopyToVector()
        return holder.parameters.view(vector)

    def _value(self, holder: Holder, name: str) -> Any:
        """A number, or a list as in a scenario."""
        default = holder.parameters.defaults[name]
        if holder.group is None:
            return default.tolist()
        vector = self._context.get_numeric_parameter(holder.group).CopyToVector()
        if vector.dtype != float:
            vector = _floats(vector)
        return vector[holder.parameters.place(name)].reshape(default.shape).tolist()

    def _write(self, holder: Holder, name: str, value: Any) -> None:
        assert holder.group is not None
        vector = self._context.get_numeric_parameter(holder.group).CopyToVector()
        place = holder.parameters.place(name)
        vector[place] = np.ravel(np.asarray(value, dtype=vector.dtype))
        self._context.get_mutable_numeric_parameter(holder.group).SetFromVector(vector)

    def _begin_anew(self, blocks: dict[str, System]) -> None:
        """Lets what has not run yet begin with the values; in a loop of floats alone."""
        for block in blocks.values():
            begin_anew = getattr(block, "begin_anew", None)
            if begin_anew is not None and isinstance(self._context, Context):
                begin_anew(self._loop.GetMutableSubsystemContext(block, self._context))


def _require_path(path: Any) -> None:
    remedy = 'give a scenario path, such as "system.load_mass"'
    require(isinstance(path, str), "parameter", path, remedy)


def _innermost(loop: Diagram, context: Context) -> tuple[Diagram, Context]:
    """The diagram whose own blocks have the parameters, and its context.

    Raises:
        ScenarioError: it is a converted one, or holds several loops.
    """
    blocks = loop.GetSystems() if isinstance(loop, Diagram) else []
    require(
        isinstance(loop, Diagram) and not any(map(is_converted, blocks)),
        "loop",
        type(loop).__name__ + (", converted or cloned" if blocks else ""),
        "give the loop that it was made of; its contexts are copied by "
        "SetTimeStateAndParametersFrom",
    )
    inner = [title(block) for block in blocks if _is_loop(block)]
    remedy = "give the loop inside of it, and loop.GetMyMutableContextFromRoot(root)"
    require(_is_loop(loop) or not inner, "loop", f"a diagram around {' and '.join(inner)}", remedy)
    if isinstance(context, Context_[AutoDiffXd]):
        count, own = context.num_numeric_parameter_groups(), loop.num_numeric_parameter_groups()
        given = f"a converted one of {count} numeric parameters"
        remedy = f"give that of the loop itself, which has {own}"
        require(count == own and not (_is_loop(loop) and inner), "context", given, remedy)
        return loop, context
    require_own_context("context", loop, context)
    return innermost(loop, context, LOOP_SIGNALS) if _is_loop(loop) else (loop, context)


def _is_loop(system: System) -> bool:
    return isinstance(system, Diagram) and all(len(ports_of(system, s)) == 1 for s in LOOP_SIGNALS)


def holders_in(loop: Diagram) -> Iterator[Holder]:
    """The parameters of the blocks of a loop that go by their models and configs."""
    first = 0
    for block in loop.GetSystems():
        found: Any
        for _, found, group in declared(block, first):
            if hasattr(found, "fixed"):  # of a block's config and system
                place = group if len(found) > 0 else None
                yield Holder(title(block), block, found, place)
        first += block.num_numeric_parameter_groups()


@dataclass(frozen=True)
class _GivenPattern:
    """A pattern's config that makes what is given."""

    pattern: InternalForcePattern

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern."""
        return self.pattern


def _spread_of(model: Model, offset: Any) -> float:
    """The spread that gives an offset (3n,)."""
    built = model.pattern.offset
    k = int(np.argmax(np.abs(built)))
    ratio = float(offset[k] / built[k])
    return ratio * getattr(model.pattern_config, _SPREAD)


def _plain(value: Any) -> Any:
    """Numbers without their derivatives; arrays as lists."""
    array = _array(value)
    if _has_derivatives(value):
        array = _floats(array.ravel()).reshape(array.shape)
    return array.tolist() if isinstance(value, np.ndarray) or array.dtype != object else value


def _array(value: Any) -> NDArray:
    """The value as an array; of an object where it is none."""
    try:
        return np.asarray(value)
    except ValueError:  # lists of several lengths
        return np.full((), None)


def _has_derivatives(value: Any) -> bool:
    array = _array(value)
    return array.dtype == object and any(isinstance(v, AutoDiffXd) for v in array.ravel())


def _are_same(one: Any, other: Any) -> bool:
    """Whether two numbers, or arrays (1,), are equal with their derivatives, none being zeros."""
    (a,), (b,) = np.ravel(one), np.ravel(other)
    if not (isinstance(a, AutoDiffXd) or isinstance(b, AutoDiffXd)):
        return bool(a == b)
    difference = AutoDiffXd(0.0) + a - b
    return difference.value() == 0 and not np.any(difference.derivatives())


def _floats(vector: Iterable[Any]) -> NDArray:
    return np.array([v.value() if isinstance(v, AutoDiffXd) else float(v) for v in vector])
