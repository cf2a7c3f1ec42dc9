"""Numbers of the controllers' model that a plan goes by."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.model.block import LOAD
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.planning.problem_config import LimitsConfig, range_for


class ModelParameters(NamedTuple):
    """Numbers of the controllers' model and of the layer that may change between plans."""

    load_mass: NDArray  # (1,), kg
    load_inertia: NDArray  # (9,), kg m², in L, row by row
    load_drag: NDArray  # (1,), N s/m
    load_angular_drag: NDArray  # (1,), N m s/rad
    gravity: NDArray  # (1,), m/s²
    rest_length: NDArray  # (1,), m
    compliance: NDArray  # (1,), m/N
    nominal: NDArray  # (2,), [ξ, A] at the start, rad/s and N
    lower: NDArray  # (2,), bounds of [ξ, A]
    upper: NDArray  # (2,)
    offset: NDArray  # (3n,), N, in L, of the pattern; (0,) where it has none


OF_MODEL = (*LOAD, "cable_length", "cable_stiffness")
OF_CONFIG = ("frequency", "amplitude", "frequency_bounds", "amplitude_bounds")


def model_parameters_of(model: Model, config: LimitsConfig) -> ModelParameters:
    """Data of a model and a config."""
    numbers = {name: model.number(name) for name in (*OF_MODEL, *model.offset_parameter)}
    numbers |= {name: getattr(config, name) for name in OF_CONFIG}
    return beliefs_from(
        {name: np.atleast_1d(np.array(value, float)) for name, value in numbers.items()}, model.n
    )


def beliefs_from(numbers: Mapping[str, NDArray], n: int) -> ModelParameters:
    """Parameters of the numbers of `OF_MODEL` and `OF_CONFIG`, arrays by name, for n carriers.

    Amplitude bounds that are empty or zero stand for those from the weight.
    """
    amplitudes = numbers["amplitude_bounds"]
    if not amplitudes.any():
        share = float(numbers["load_mass"][0] * numbers["gravity"][0]) / n
        amplitudes = np.array(range_for(share, float(numbers["amplitude"][0])))
    lower, upper = np.transpose([numbers["frequency_bounds"], amplitudes])
    return ModelParameters(
        load_mass=numbers["load_mass"],
        load_inertia=numbers["load_inertia"].ravel(),
        load_drag=numbers["load_drag"],
        load_angular_drag=numbers["load_angular_drag"],
        gravity=numbers["gravity"],
        rest_length=numbers["cable_length"],
        compliance=compliance_of(numbers["cable_stiffness"]),
        nominal=np.concatenate([numbers["frequency"], numbers["amplitude"]]),
        lower=lower,
        upper=upper,
        offset=numbers.get(OFFSET, np.zeros(0)),
    )
