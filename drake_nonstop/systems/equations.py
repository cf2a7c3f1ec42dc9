"""What a block computes: one pure function of arrays, traced once by CasADi.

The function takes, in this order, the state of the block, if it has one, an array for each signal
that it reads, an array for each of its quantities, and the time (1,) in s, if it reads that; its
parameters it takes by name. It returns the rate of the state, or the next one, if there is a
state, and an array for each signal that it makes.

From the trace follow what feeds through to what, a fast evaluation with floats, and the block's
part of a compiled loop.
"""

import functools
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd, ExtractValue
from pydrake.symbolic import Variable

from drake_nonstop.mechanics.signals import SAMPLE_TIME
from drake_nonstop.systems.parameters import NumericParameters
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError, object_array, recent
from drake_nonstop.validation import ScenarioError, one_line, require

# Names of what is no signal: the state or, as a result, its rate or the next one; the state at the
# start of a run; the time; the parameters.
STATE, START, TIME, NUMBERS = "(state)", "(start)", "(time)", "(parameters)"
_SAID = {STATE: "the state's rate or the next state", START: "the state"}
_CSE = {"cse": True}


class Group(NamedTuple):
    """Results that depend on the same arguments, and are made together."""

    reads: tuple[str, ...]
    makes: tuple[str, ...]
    function: casadi.Function  # of the arguments, each by itself, for the results


class BetweenSamples(NamedTuple):
    """How outputs of a block move between the samples at which it makes others.

    `function` takes the outputs of the names `reads`, and the time (1,) in s since the sample; what
    it returns are the outputs of the names `makes`, which `equations` then do not make. The block
    reads `sample_time`.
    """

    function: Callable
    reads: Sequence[str]
    makes: Any  # names; of `Equations`, with their sizes
    key: Any = None  # all that the function depends on besides; None: it is not known
    title: str = "block"  # of the function in errors

    def compute(self, values: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """The outputs, of arguments of any scalar type, with the two times."""
        since = values[TIME] - values[SAMPLE_TIME]
        given = [values[name] for name in self.reads]
        return made_by(f"{self.title}.between_samples", self.function, self.makes, *given, since)


def made_by(
    name: str, function: Callable, sizes: Mapping[str, int], *inputs: NDArray, **values: NDArray
) -> dict[str, NDArray]:
    """The arrays of these sizes that a function returns, by name.

    Raises:
        ScenarioError: it cannot compute them, or returns others; the message has its name.
    """
    try:
        made = function(*inputs, **values)
        made = made if isinstance(made, tuple) else (made,)
        arrays = [np.asarray(each).ravel() for each in made]
    except (ScenarioError, NotFiniteError):
        raise
    except Exception as error:  # whatever a user's own code may raise
        remedy = (
            "take what is declared, and compute by arithmetic of arrays, without branches "
            "(systems.tracing.where) or np.linalg.norm (mechanics.rotation.norm), with numbers as "
            "arrays (1,), such as x[:1] and not x[0]"
        )
        frame = traceback.extract_tb(error.__traceback__)[1:2]  # empty: the arguments do not fit
        place = "".join(f", line {each.lineno} of {Path(each.filename).name}" for each in frame)
        # CasADi has thousands of frames for one that is too deep.
        cause = None if isinstance(error, RecursionError) else error
        raise ScenarioError(f"{name}{place} = {one_line(error)}: {remedy}") from cause
    found = [array.size for array in arrays]
    asked = ", ".join(f"{_SAID.get(k, k)} ({size})" for k, size in sizes.items())
    remedy = f"return an array for each of {asked}"
    require(found == [*sizes.values()], name, f"arrays of {found} numbers", remedy)
    return dict(zip(sizes, arrays, strict=True))


class Equations:
    """A function of a block, and what its arguments and results are.

    Args:
        function: see the module.
        inputs, quantities, outputs: sizes by name; the outputs without those that show the state.
        optional: inputs that may be left unconnected, and their values then.
        state: (s,), in a new context; empty: there is none.
        shown: sizes of the outputs, by name, that show the state: one part after the other.
        reads_time: whether the function takes the time.
        parameters: of the context; None: it has none.
        period: s, between steps of a sampled state; 0: the state is continuous.
        makes_next_state: whether the function returns the next sampled state, and not its rate; a
            layer's then steps at each sample, besides its answers.
        start: function as `function` that returns the state at the start of a run; None: it is the
            one of a new context.
        starts_first: whether that is made before the states of other blocks start.
        key: all that the functions depend on besides their arguments; None: it is not known.
        joint: whether all results are made together.
        title: of the functions in errors.
        answers: whether a function in Python answers the next state, of a layer: the equations then
            make outputs alone, unless they make the next state, too.
        motion: how further outputs follow from these between samples; None: there are none.

    Attributes:
        arguments, results: sizes by name, with those that are no signals.
    """

    def __init__(
        self,
        function: Callable,
        *,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int],
        quantities: Mapping[str, int] | None = None,
        optional: Mapping[str, float] | None = None,
        state: Any = (),
        shown: Mapping[str, int] | None = None,
        reads_time: bool = False,
        parameters: NumericParameters | None = None,
        period: float = 0.0,
        makes_next_state: bool = False,
        start: Callable | None = None,
        starts_first: bool = False,
        key: Any = None,
        joint: bool = False,
        title: str = "block",
        answers: bool = False,
        motion: BetweenSamples | None = None,
    ):
        self.inputs, self.outputs = dict(inputs), dict(outputs)
        self.motion = motion
        self.quantities = dict(quantities or {})
        self.optional = {k: np.full(inputs[k], v) for k, v in (optional or {}).items()}
        self.state, self.shown = np.array(state, float), dict(shown or {})
        self.parameters = parameters or NumericParameters({})
        self.period = period if len(self.state) else 0.0
        self.starts_first = starts_first
        self._function, self._start, self._joint, self._title = function, start, joint, title
        self._makes_next_state = makes_next_state
        has_state = {STATE: len(self.state)} if len(self.state) else {}
        self.arguments = has_state | self.inputs | self.quantities
        self.arguments |= {TIME: 1} if reads_time else {}
        self._positional = [*self.arguments]
        self.arguments |= {NUMBERS: len(self.parameters)} if len(self.parameters) else {}
        self.answers = answers
        self.results = (
            ({} if answers and not makes_next_state else has_state)
            | self.outputs
            | ({START: len(self.state)} if start else {})
        )
        shapes = tuple((k, v.shape) for k, v in self.parameters.defaults.items())
        sizes = tuple(self.arguments.items()), tuple(self.results.items()), shapes
        moved = None if motion is None else (motion.key, motion.reads, tuple(motion.makes))
        own: Any = self.period, makes_next_state, joint, answers, starts_first
        # Of one function a subclass may show other parts, or give others to what is not connected.
        own += tuple(self.shown.items()), tuple((k, *v) for k, v in self.optional.items())
        known = key is not None and (motion is None or motion.key is not None)
        self.key = (key, sizes, own, moved) if known else None

    def compute(self, values: Mapping[str, NDArray], *, starts: bool = False) -> dict[str, NDArray]:
        """All results but the start, or the start alone, of arguments of any scalar type."""
        given = [values[name] for name in self._positional]
        numbers = self.parameters.view(values[NUMBERS]) if len(self.parameters) else {}
        if starts:
            assert self._start is not None
            sizes = {START: len(self.state)}
            return made_by(f"{self._title}.start", self._start, sizes, *given, **numbers)
        sizes = {name: size for name, size in self.results.items() if name != START}
        results = made_by(f"{self._title}.equations", self._function, sizes, *given, **numbers)
        if STATE in results and self.period and not self._makes_next_state:
            results[STATE] = values[STATE] + self.period * results[STATE]
        return results

    @functools.cached_property
    def groups(self) -> list[Group]:
        """The results, by what they depend on."""
        groups: list[Group] = recent(self._traced, self.key)
        return groups

    @functools.cached_property
    def group_of(self) -> dict[str, Group]:
        """The group of each result, by name."""
        return {name: group for group in self.groups for name in group.makes}

    def reads_of(self, result: str) -> tuple[str, ...]:
        """Names of the arguments that a result, or an output that shows the state, depends on."""
        return (STATE,) if result in self.shown else self.group_of[result].reads

    def _traced(self) -> list[Group]:
        symbols, values = _symbols(self.arguments)
        made = self.compute(values)
        if self._start is not None:
            made |= self.compute(values, starts=True)
        for name, array in made.items():
            is_lost = any(isinstance(value, float) and np.isnan(value) for value in array)
            remedy = "make arrays by np.concatenate or np.array; one of floats takes no symbols"
            require(
                not is_lost, f"{self._title}.equations", f"NaN in {_SAID.get(name, name)}", remedy
            )
        results = _stacked(made)
        reads = _dependence(symbols, results)
        if self._joint or _calls_functions(results):  # which are not called for each output anew
            apart = (START,) if self._joint else (START, STATE)
            joint = [read for k, read in reads.items() if k not in apart]
            everything = tuple(k for k in symbols if any(k in read for read in joint))
            reads = {k: read if k in apart else everything for k, read in reads.items()}
        together: dict[tuple[str, ...], list[str]] = {}
        for name, read in reads.items():
            together.setdefault(read if name != START else (START, *read), []).append(name)
        groups = [_group(symbols, results, makes, reads[makes[0]]) for makes in together.values()]
        return groups + ([] if self.motion is None else self._traced_motion(self.motion))

    def _traced_motion(self, motion: BetweenSamples) -> list[Group]:
        """The outputs that move, each a function of outputs of the block, and of two times."""
        sizes = {name: self.outputs[name] for name in motion.reads} | {SAMPLE_TIME: 1, TIME: 1}
        symbols, values = _symbols(sizes)
        results = _stacked(motion.compute(values))
        reads = _dependence(symbols, results)
        return [_group(symbols, results, [name], reads[name]) for name in results]


def _symbols(sizes: Mapping[str, int]) -> tuple[dict[str, casadi.SX], dict[str, NDArray]]:
    """Symbols of these sizes, and arrays of their entries."""
    symbols = {name: casadi.SX.sym(name, size) for name, size in sizes.items()}
    return symbols, {name: object_array(symbol) for name, symbol in symbols.items()}


def _stacked(made: Mapping[str, NDArray]) -> dict[str, casadi.SX]:
    return {k: casadi.densify(casadi.SX(casadi.vertcat(*v))) for k, v in made.items()}


def _dependence(
    symbols: Mapping[str, casadi.SX], results: Mapping[str, casadi.SX]
) -> dict[str, tuple[str, ...]]:
    """Names of the symbols that an entry of each result depends on."""
    if not symbols or not results:
        return dict.fromkeys(results, ())
    given, made = casadi.vertcat(*symbols.values()), casadi.vertcat(*results.values())
    whole = casadi.Function("whole", [given], [made], {"allow_free": True})
    rows, columns = whole.jac_sparsity(0, 0).get_triplet()
    ends = [np.cumsum([v.numel() for v in each.values()]) for each in (results, symbols)]
    numbers, read = (
        np.searchsorted(end, place, "right")
        for end, place in zip(ends, (rows, columns), strict=True)
    )
    names = [*symbols]
    return {
        result: tuple(names[i] for i in np.unique(read[numbers == k]))
        for k, result in enumerate(results)
    }


def _calls_functions(results: Mapping[str, casadi.SX]) -> bool:
    made = casadi.SX(casadi.vertcat(*results.values()))  # of none it would be numbers
    function = casadi.Function("calls", casadi.symvar(made), [made], {"allow_free": True})
    return casadi.OP_CALL in map(function.instruction_id, range(function.n_instructions()))


def _group(
    symbols: Mapping[str, casadi.SX],
    results: Mapping[str, casadi.SX],
    makes: Sequence[str],
    reads: tuple[str, ...],
) -> Group:
    given, made = [symbols[name] for name in reads], [results[name] for name in makes]
    function = casadi.Function("part", given, made, _CSE | {"allow_free": True})
    if function.has_free():  # given to a function that is called, for other results
        free = function.free_sx()
        made = casadi.substitute(made, free, [casadi.SX(0)] * len(free))
        function = casadi.Function("part", given, made, _CSE)
    return Group(reads, tuple(makes), function)


def evaluated(
    equations: Equations,
    group: Group,
    values: Sequence[NDArray],
    scalar: Any,
    name: Callable[[], str],
) -> list[NDArray]:
    """Results of a group on arrays of AutoDiffXd or Expression, by the equations themselves."""
    motion, sizes = equations.motion, {SAMPLE_TIME: 1, TIME: 1} | equations.arguments
    if motion is not None:
        sizes |= {name: equations.outputs[name] for name in motion.reads}
    given = {k: np.array([_unread(scalar) for _ in range(size)]) for k, size in sizes.items()}
    given |= zip(group.reads, values, strict=True)
    with np.errstate(invalid="ignore"):  # Expression raises the flag without a cause
        if motion is not None and group.makes[0] in motion.makes:
            results = motion.compute(given)
        else:
            results = equations.compute(given, starts=START in group.makes)
    made = [_of_scalar(results[name], scalar) for name in group.makes]
    if scalar is AutoDiffXd:
        norms = [np.linalg.norm(ExtractValue(value)) for value in made]
        if not max(norms, default=0.0) < LARGEST:
            read = np.concatenate([np.zeros(0), *(ExtractValue(v).ravel() for v in values)])
            raise NotFiniteError(name(), was_given=not np.all(np.abs(read) < LARGEST))
    return made


def _unread(scalar: Any) -> Any:
    """A value of what is not read; no two differ by zero, which could be divided by."""
    return scalar(1.0) if scalar is AutoDiffXd else scalar(Variable("unread"))


def _of_scalar(values: Iterable[Any], scalar: Any) -> NDArray:
    return np.array([v if isinstance(v, scalar) else scalar(v) for v in values], dtype=object)
