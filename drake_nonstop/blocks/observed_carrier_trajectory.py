"""References of carriers that measure their tension, for "Carrier Desired Trajectories"."""

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks.carrier_trajectory import (
    BowedCarrierTrajectory,
    BowedReferencesConfig,
    CarrierReferenceBlock,
    bowed_references,
    corrected,
)
from drake_nonstop.mechanics.load_share import (
    SHARE_SIZE,
    observed_drag,
    observed_lengths,
    observed_share,
    share_of_mass,
    shared_forces,
)
from drake_nonstop.mechanics.reference_correction import CORRECTION_SIZE
from drake_nonstop.mechanics.rotation import norm, rotation_matrix
from drake_nonstop.mechanics.signals import CarrierStates, LoadState
from drake_nonstop.model.block import with_this_sample
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.systems.tracing import where
from drake_nonstop.validation import non_negative, require

_BOX = "carrier_trajectory"
_CORRECTION = 2 * CORRECTION_SIZE
_TURN_AND_LEVEL = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])  # of a correction
OBSERVER_RATES = ("length_rate", "share_rate", "drag_rate")


@dataclass(kw_only=True)
class ObservedCarrierTrajectoryConfig(BowedReferencesConfig):
    """As of `BowedCarrierTrajectory`, and how fast what is observed answers what is measured.

    With a rate of 0 it stays as at the start.
    """

    length_rate: float = non_negative(0.2)  # 1/s, of the cables' lengths
    share_rate: float = non_negative(0.15)  # 1/s, of the load's mass and its centre
    drag_rate: float = non_negative(0.3)  # 1/s, of the cables' drag


class ObservedCarrierTrajectory(BowedCarrierTrajectory):
    """References of `BowedCarrierTrajectory` for the cables and the load that tensions tell of.

    Three observers, for carriers whose cables have load cells. A cable's length: where its measured
    chord is longer than the model's by more than its tension explains, it is longer. The share s of
    the load that each cable has to carry: tensions beyond the desired forces, by least squares
    over [1, x, y] of the attachments, scale the forces, spread included, without the net wrench
    that unlike cables would have. s is the load's mass and its centre of mass. The drag of the
    cables: what lengths explain ill, since it changes as the bows do. See `mechanics.load_share`.

    The state has that of the corrections, then s, what each cable is longer, and the logarithm of
    the cables' drag over the model's. A run starts with the lengths that the plant's cables show,
    and with s in the place of corrections of height and tilt.

    Raises:
        ScenarioError: as of `BowedCarrierTrajectory`; a rate is negative, or faster than the
            samples.
    """

    reads = (
        *BowedCarrierTrajectory.reads[:7],
        *("carrier_state", "tensions"),
        *BowedCarrierTrajectory.reads[7:],
    )
    makes = (
        *BowedCarrierTrajectory.makes,
        *("load_mass_estimate", "centre_of_mass_estimate"),
        *("cable_length_estimate", "cable_drag_estimate"),
    )
    own = OBSERVER_RATES
    where: ClassVar = CarrierReferenceBlock.where

    @classmethod
    def has_state(cls, model: Model, config: Any) -> bool:
        return True

    def state(self, model: Model) -> NDArray:
        return np.zeros(_CORRECTION + SHARE_SIZE + model.n + 1)

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        super().check(model, config)
        if model.control_period > 0:
            for name in OBSERVER_RATES:
                value, most = getattr(config, name), 1 / model.control_period
                remedy = f"give less than one per control period, {most:g} 1/s"
                require(value < most, f"{_BOX}.{name}", value, remedy)

    @staticmethod
    def equations(  # type: ignore[override]
        state: NDArray,
        reference: NDArray,
        forces: NDArray,
        rates: NDArray,
        planned: NDArray,
        wind: NDArray,
        reference_higher_rates: NDArray,
        gusts: NDArray,
        carrier_state: NDArray,
        tensions: NDArray,
        *measured: NDArray,
        corrects: bool,
        control_period: float,
        length_rate: NDArray,
        share_rate: NDArray,
        drag_rate: NDArray,
        correction_rates: NDArray,
        correction_time: NDArray,
        **numbers: Any,
    ) -> tuple[NDArray, ...]:
        attachments, pseudo_inverse = numbers["attachments"], numbers["pseudo_inverse"]
        correction, share, longer, log_drag = ObservedCarrierTrajectory.parts(state)
        lengths = numbers["cable_length"] + longer
        drag = np.exp(log_drag)
        cables: dict[str, Any] = {"cable_length": lengths}
        cables |= {name: drag * numbers[name] for name in ("cable_drag", "cable_friction")}
        desired = forces.reshape(-1, 3)
        correction, given = corrected(
            correction,
            (reference, attachments, desired, rates.reshape(-1, 3)),
            measured,
            control_period,
            correction_rates,
            correction_time,
        )
        found = bowed_references(
            *(given, planned, wind, reference_higher_rates, gusts),
            carried=partial(
                shared_forces, share=share, attachments=attachments, pseudo_inverse=pseudo_inverse
            ),
            **(numbers | cables),
        )
        load_state, attitude, *sample_time = measured
        load = LoadState.view(load_state)
        is_told = (attitude * attitude).sum() > 0
        axes = rotation_matrix(where(is_told, attitude, load.quaternion)).T
        ends = load.position + attachments @ axes
        missing = observed_share(tensions, found.carried, desired, attachments)
        longer_still, bow = observed_lengths(
            tensions,
            norm(CarrierStates.view(carrier_state).positions - ends)[:, 0],
            found.carried,
            norm(found.position - found.ends)[:, 0],
            lengths,
            numbers["cable_stiffness"],
        )
        observed = np.concatenate(
            [
                share_rate * missing,
                length_rate * longer_still,
                drag_rate * observed_drag(longer_still, bow, lengths),
            ]
        )
        observed, _ = with_this_sample(state[_CORRECTION:], observed, sample_time, control_period)
        heavier, centre = share_of_mass(share, pseudo_inverse, attachments)
        return (
            np.concatenate([correction, observed]),
            *found.beside(forces, rates),
            heavier * numbers["load_mass"],
            centre,
            lengths,
            drag,
        )

    def SetCorrection(self, context: Context, correction: NDArray) -> NDArray:
        """As of `CarrierTrajectory`, with the share in the place of height and tilt."""
        rest = super().SetCorrection(context, correction * _TURN_AND_LEVEL)
        correction_state, _, *observed = self.parts(state_values(context))
        share = correction[[5, 1, 0]]
        set_state_values(context, np.concatenate([correction_state, share, *observed]))
        return rest

    def ObserveLengths(self, context: Context, share: float) -> NDArray:
        """Changes the cables' lengths by a share of what the inputs in a context of the block tell.

        Returns by how much (n,), m, they change.
        """
        ports = map(self.GetInputPort, self.inputs(self.model))
        values = [p.Eval(context) if p.HasValue(context) else np.zeros(p.size()) for p in ports]
        if self.model.control_period > 0:
            values[-1] = np.ones(1)  # of samples the first does not step
        numbers: dict[str, Any] = {**parameters_in(self, context)}
        numbers |= dict.fromkeys(OBSERVER_RATES, 1.0)
        numbers = {name: np.atleast_1d(number) for name, number in numbers.items()}
        state = state_values(context)
        equations: Any = self.equations
        rate, *_ = equations(state, *values, **self.constants(self.model, self.config), **numbers)
        *others, longer, log_drag = self.parts(state)
        change = share * self.parts(rate)[-2]
        set_state_values(context, np.concatenate([*others, longer + change, log_drag]))
        return change

    @staticmethod
    def parts(state: NDArray) -> list[NDArray]:
        """Corrections, share, lengths and drag in the state."""
        return np.split(state, [_CORRECTION, _CORRECTION + SHARE_SIZE, len(state) - 1])
