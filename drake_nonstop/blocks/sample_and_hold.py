"""The inputs of sampled controllers, held from one sample to the next."""

from pydrake.systems.framework import Context, State

from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import LeafBlock

HELD_SIGNALS = {"measured_load_state": 13, "reference": 22}  # name -> size


class SampleAndHold(LeafBlock):
    """Samples what enters the controllers every `control_period`, and holds it.

    The block stands once, in front of all controllers, instead of a hold in each, which
    would add a sample of delay per block. The sample is taken by an unrestricted update:
    Drake runs those before discrete ones, so that an optimization layer that updates at
    the same instant reads the new sample (Drake's ZeroOrderHold is a discrete update and
    would give it the one before).

    .. pydrake_system::

        name: SampleAndHold
        input_ports:
        - measured_load_state
        - reference
        output_ports:
        - held_measured_load_state
        - held_reference
        - sample_time

    Sizes as in `HELD_SIGNALS`; `sample_time` (1) is the time of the sample in s.
    """

    def __init__(self, model: Model):
        super().__init__()
        self._inputs = []
        for name, size in HELD_SIGNALS.items():
            self._inputs.append(self.DeclareVectorInputPort(name, size))
            self.DeclareStateOutputPort(f"held_{name}", self.DeclareDiscreteState(size))
        self.DeclareStateOutputPort("sample_time", self.DeclareDiscreteState(1))
        period = model.control_period
        self.DeclareInitializationUnrestrictedUpdateEvent(self._sample)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, period, self._sample)

    def _sample(self, context: Context, state: State) -> None:
        held = state.get_mutable_discrete_state()
        for i, port in enumerate(self._inputs):
            held.set_value(i, port.Eval(context))
        held.set_value(len(self._inputs), [context.get_time()])
