"""The inputs of sampled controllers, held from one sample to the next."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, State

from drake_nonstop.mechanics.signal_layouts import Layout, Part
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    REFERENCE_HIGHER_RATES_SIZE,
    WIND_SIZE,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.diagram_trace import At

_POSES = ("measured_load_state", "reference")  # begin with a quaternion
_HIGHER_RATES = "reference_higher_rates"
HELD_SIGNALS = {
    "measured_load_state": LOAD_STATE_SIZE,
    "reference": LOAD_REFERENCE_SIZE,
    _HIGHER_RATES: REFERENCE_HIGHER_RATES_SIZE,
}


class SampleAndHold(LeafBlock):
    """Samples the controllers' inputs every `control_period`, and holds them.

    The block stands once, in front of all controllers, instead of a hold in each, which
    would add a sample of delay per block. The sample is taken by an unrestricted update:
    Drake runs those before discrete ones, so that an optimization layer that updates at
    the same instant reads the new sample (Drake's ZeroOrderHold is a discrete update and
    would give it the one before).

    What is left unconnected is held as zero.

    Args:
        model: its control period.
        initial_values: the signals that are held before the first sample, by their names; those
            that are not given are a load at rest at the origin.
        holds_wind: whether `wind_estimate` is held, too, for a wind that is not constant.

    Attributes:
        period: s, between samples.
    """

    reads = ("measured_load_state", "reference", "reference_higher_rates", "wind_estimate")
    makes = (
        "held_measured_load_state",
        "held_reference",
        "held_reference_higher_rates",
        "held_wind_estimate",
        "sample_time",
    )
    where: ClassVar = {"wind_estimate": "it is held", "held_wind_estimate": "it is held"}

    optional_inputs = (_HIGHER_RATES,)
    signal_layouts: ClassVar = {"sample_time": Layout(Part("", "1", "s"))}

    def __init__(
        self,
        model: Model,
        initial_values: Mapping[str, NDArray] | None = None,
        *,
        holds_wind: bool = False,
    ):
        super().__init__()
        self._inputs = []
        signals = HELD_SIGNALS | ({"wind_estimate": WIND_SIZE} if holds_wind else {})
        at_rest = {
            name: np.eye(size)[0] if name in _POSES else np.zeros(size)
            for name, size in signals.items()
        }
        initial_values = at_rest | dict(initial_values or {})
        for name, size in signals.items():
            self._inputs.append(self.DeclareVectorInputPort(name, size))
            initial = initial_values[name]
            self.DeclareStateOutputPort(f"held_{name}", self.DeclareDiscreteState(initial))
        self._optional = [*signals].index(_HIGHER_RATES)
        self.DeclareStateOutputPort("sample_time", self.DeclareDiscreteState(1))
        self.period = period = model.control_period
        self.DeclareInitializationUnrestrictedUpdateEvent(self._sample)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, period, self._sample)

    trace_key = ()
    updates_first = True  # before others' updates at the same instant
    updates_at_start = True

    def traced_output(self, port: str, at: At) -> NDArray:
        names = [self.get_output_port(k).get_name() for k in range(self.num_output_ports())]
        return at.state(1 + names.index(port))

    def traced_update(self, at: At) -> list[NDArray]:
        names = [port.get_name() for port in self._inputs]
        held = [at.input_or(name, at.state(1 + k)) for k, name in enumerate(names)]
        return [*held, at.time]

    def _sample(self, context: Context, state: State) -> None:
        held = state.get_mutable_discrete_state()
        for i, port in enumerate(self._inputs):
            if i != self._optional or port.HasValue(context):
                held.set_value(i, port.Eval(context))
        held.set_value(len(self._inputs), [context.get_time()])
