"""Loops of aircraft with a plain controller of their own."""

import numpy as np

from drake_nonstop import parse_scenario
from drake_nonstop.mechanics.aircraft import flight_needs, needed_force
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.systems.equation_block import EquationBlock
from drake_nonstop.systems.equations import Equations

TEXT = """
flying:
  simulation_duration: 1.0
  simulator_config: {max_step_size: 0.01}
  system:
    load_mass: 7.5
    load_inertia: [[3, 0, 0], [0, 3, 0], [0, 0, 6]]
    load_drag: 0.6
    cable_length: 150.0
    cable_stiffness: 120.0
    cable_damping: 2.0
    attachments: [[1.5, 0, 0], [-0.75, 1.299, 0], [-0.75, -1.299, 0]]
    aircraft: {model: rascal_110}
  pattern: !SpreadCarousel {spread: 6.75}
  optimization_layer: !ConstantParameters {frequency: 0.6, amplitude: 4.5}
  wrench_controller: !WrenchController
    position_gain: 0.4
    velocity_gain: 4.0
    position_integral_gain: 0.0
    orientation_gain: 0.0
    angular_velocity_gain: 0.0
    orientation_integral_gain: 0.0
  load_feedback: !DesiredStateFeedback {}
  carrier_dynamics: !FixedWingDynamics {}
"""


def flying(*overrides):
    """Three aircraft over a load at rest."""
    return changed(parse_scenario(TEXT), overrides)


def controller(model):
    """Commands of the exact inverse, without lead, observer or limits; in still air."""
    n, aircraft = model.n, model.aircraft

    def command(reference, state, acceleration, pull):
        position_error, velocity_error = (reference - state).reshape(2, n, 3)
        wanted = acceleration.reshape(n, 3) + 2.25 * position_error + 2.7 * velocity_error
        force = needed_force(aircraft, wanted, pull.reshape(n, 3))
        velocity = state[3 * n :].reshape(n, 3)
        return np.concatenate(flight_needs(aircraft, force, velocity).command)

    equations = Equations(
        command,
        inputs={
            "carrier_reference": 6 * n,
            "carrier_state": 6 * n,
            "carrier_reference_acceleration": 3 * n,
            "desired_cable_forces": 3 * n,
        },
        outputs={"aircraft_command": 3 * n},
    )
    return EquationBlock(equations)
