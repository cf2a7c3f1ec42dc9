"""The controller half of box "Carrier Controller + Dynamics", for carriers that feel a load."""

from dataclasses import asdict, dataclass

from drake_nonstop.mechanics.carrier import loaded_pid_forces
from drake_nonstop.system import Model
from drake_nonstop.traced_block import TracedBlock
from drake_nonstop.validation import require_non_negative


@dataclass(kw_only=True)
class LoadedCarrierPidConfig:
    """Gains on each axis."""

    position_gain: float = 1000.0  # N/m
    velocity_gain: float = 10.0  # N s/m


class LoadedCarrierPid(TracedBlock):
    """u = K_p (p_d − p) + K_d (v_d − v) + m_c g e₃ + f_d, for every carrier.

    It carries the weight and the desired pull of the cable beforehand; the load's wrench
    controller, which integrates, corrects what it believes wrongly of the load.

    .. pydrake_system::

        name: LoadedCarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        - desired_cable_forces
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions, velocities], in W;
    `desired_cable_forces` and `carrier_forces` (3n) in N, in W.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: LoadedCarrierPidConfig | None = None):
        config = config or LoadedCarrierPidConfig()
        require_non_negative("carrier_controller", **asdict(config))
        n = model.n
        super().__init__(
            lambda reference, state, cables: loaded_pid_forces(
                reference,
                state,
                cables,
                mass=model.carrier_mass,
                gravity=model.gravity,
                **asdict(config),
            ),
            inputs={
                "carrier_reference": 6 * n,
                "carrier_state": 6 * n,
                "desired_cable_forces": 3 * n,
            },
            outputs={"carrier_forces": 3 * n},
        )
