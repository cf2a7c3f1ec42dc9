"""Energies of blocks, against MultibodyPlant, and of whole loops, against the work that is done."""

import numpy as np
import pytest
from helpers import INERTIA, difference, model, nightly_beyond, output, regular, rotation
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop.blocks.cables import Cables
from drake_nonstop.blocks.carrier_dynamics import (
    CarrierDynamics,
    CarrierDynamicsConfig,
    LimitedCarriers,
    LimitedCarriersConfig,
)
from drake_nonstop.blocks.load_plant import LoadPlant, MultibodyLoadPlant
from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import set_equilibrium
from drake_nonstop.mechanics.signals import CarrierStates, LoadState
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.energy import kinetic_energy, potential_energy
from drake_nonstop.validation import ScenarioError

GRAVITY = 9.81


def free_bodies(masses, inertia=None):
    """A MultibodyPlant of free bodies, and its context."""
    plant = MultibodyPlant(time_step=0.0)
    for i, mass in enumerate(masses):
        unit = UnitInertia(1, 1, 1)
        if inertia is not None:
            unit = inertia / mass
            unit = UnitInertia(*np.diag(unit), Ixy=unit[0, 1], Ixz=unit[0, 2], Iyz=unit[1, 2])
        plant.AddRigidBody(f"body_{i}", SpatialInertia(mass, np.zeros(3), unit))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -GRAVITY])
    plant.Finalize()
    return plant, plant.CreateDefaultContext()


def energies(system, context):
    return [system.CalcKineticEnergy(context), system.CalcPotentialEnergy(context)]


@pytest.mark.parametrize("seed", range(5))
def test_energies_of_the_load_are_those_of_a_free_body(seed):
    rng = np.random.default_rng(seed)
    state = rng.normal(size=13)
    state[:4] /= np.linalg.norm(state[:4])
    plant, plant_context = free_bodies([1.3], INERTIA)
    plant.SetPositionsAndVelocities(plant_context, state)
    expected = energies(plant, plant_context)
    for block in (LoadPlant, MultibodyLoadPlant):
        made = block(model(load_mass=1.3, gravity=GRAVITY))
        context = made.CreateDefaultContext()
        context.SetContinuousState(state)
        found = [kinetic_energy(made, context), potential_energy(made, context)]
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("n", [3, 5])
def test_energies_of_carriers_are_those_of_free_bodies(n, seed):
    carriers = np.random.default_rng(seed).normal(size=(2, n, 3))
    plant, plant_context = free_bodies([0.2] * n)
    for i in range(n):
        velocity = np.concatenate([np.zeros(3), carriers[1, i]])
        positions = np.concatenate([[1, 0, 0, 0], carriers[0, i]])
        state = plant.GetPositions(plant_context).reshape(n, 7)
        rates = plant.GetVelocities(plant_context).reshape(n, 6)
        state[i], rates[i] = positions, velocity
        plant.SetPositions(plant_context, state.ravel())
        plant.SetVelocities(plant_context, rates.ravel())
    kinetic, potential = energies(plant, plant_context)
    system = model(n, carrier_mass=0.2, gravity=GRAVITY)
    heavy = LimitedCarriers(system, LimitedCarriersConfig(has_weight=True))
    for made, weight in ((CarrierDynamics(system), 0), (LimitedCarriers(system), 0), (heavy, 1)):
        context = made.CreateDefaultContext()
        more = np.zeros(context.num_continuous_states() - carriers.size)
        context.SetContinuousState(np.append(carriers, more))
        expected = [kinetic, weight * potential]
        np.testing.assert_allclose(energies(made, context), expected, rtol=1e-12, atol=1e-12)


def test_elastic_energy_is_the_work_of_stretching_the_cables():
    """From slack on, with the load at rest, by the tensions of undamped cables."""
    block = Cables(model(cable_damping=0.0))
    context = block.CreateDefaultContext()
    block.GetInputPort("load_state").FixValue(context, np.eye(13)[0])
    direction = np.array([0.6, 0.0, 0.8])

    def at(length):
        ends = regular(4) + length * direction
        carriers = np.concatenate([ends.ravel(), np.zeros(12)])
        block.GetInputPort("carrier_state").FixValue(context, carriers)
        return output(block, context, "tensions").sum(), block.CalcPotentialEnergy(context)

    lengths = np.linspace(0.6, 1.1, 501)
    tensions, found = np.transpose([at(length) for length in lengths])
    work = np.concatenate([[0], np.cumsum(np.diff(lengths) * (tensions[1:] + tensions[:-1]) / 2)])
    np.testing.assert_allclose(found, work, rtol=0, atol=1e-3)
    assert found[0] == 0 < found[-1]
    assert kinetic_energy(block, context) == 0


LOADED = LimitedCarriersConfig(has_weight=True, feels_cable=True)


class NoForces(LeafSystem):
    """Carriers that nobody drives."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort(
            "carrier_forces",
            3 * model.n,
            lambda context, forces: forces.SetFromVector(np.zeros(3 * model.n)),
        )


def loop(system, **boxes):
    fields = {"optimization_layer": ConstantParametersConfig(), "control_period": 0.0} | boxes
    makers = {name: fields.pop(name) for name in list(fields) if callable(fields[name])}
    return make_nonstop(Scenario(system=system, **fields), **makers)


def power(system, diagram, context, feels_its_cable):
    """What changes the energy: the carriers' forces, drag and the cables' dampers, W."""
    load = LoadState.view(output(diagram, context, "load_state"))
    carriers = CarrierStates.view(output(diagram, context, "carrier_state"))
    forces = output(diagram, context, "carrier_forces").reshape(-1, 3)
    if feels_its_cable:  # of a force that lags behind its command
        dynamics = diagram.GetSubsystemByName("carrier_dynamics")
        own = dynamics.GetMyContextFromRoot(context).get_continuous_state_vector().CopyToVector()
        forces = system.carrier_mass * own[-forces.size :].reshape(-1, 3)
    on_load = output(diagram, context, "cable_forces").reshape(-1, 3)
    if not feels_its_cable:
        forces = forces + on_load  # as if something held it against its cable
    levers = np.array(system.attachments) @ rotation(load.quaternion).T
    cables = carriers.positions - load.position - levers
    lengths = np.linalg.norm(cables, axis=1)
    turning = np.cross(load.angular_velocity, levers)
    rates = (cables * (carriers.velocities - load.velocity - turning)).sum(axis=1) / lengths
    springs = system.cable_stiffness * (lengths - system.cable_length)
    damping = (output(diagram, context, "tensions") - springs) @ rates
    assert np.all(springs > 0)
    assert damping > 1e-3
    drag = system.load_drag * load.velocity @ load.velocity
    drag += system.load_angular_drag * load.angular_velocity @ load.angular_velocity
    return (forces * carriers.velocities).sum() - drag - damping


@pytest.mark.parametrize("load", nightly_beyond(1, "flights", [LoadPlant, MultibodyLoadPlant]))
@pytest.mark.slow
def test_a_free_undamped_loop_conserves_its_energy(load):
    system = SystemParameters(cable_damping=0.0, load_drag=0.0)
    diagram = loop(
        system,
        carrier_dynamics=LOADED,
        carrier_controller=NoForces,
        load_plant=load,
    )
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    set_equilibrium(diagram, context)  # the carriers then fall towards the load, and swing
    dynamics = diagram.GetSubsystemByName("carrier_dynamics")
    own = dynamics.GetMyMutableContextFromRoot(context)
    own.SetContinuousState(np.append(output(diagram, context, "carrier_state"), np.zeros(12)))
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    found = []
    for time in (0.0, 0.3, 0.7):
        simulator.AdvanceTo(time)
        found.append(energies(diagram, context))
    found = np.array(found)
    assert np.ptp(found[:, 0]) > 1
    np.testing.assert_allclose(found.sum(axis=1), found[0].sum(), rtol=0, atol=1e-5)


@pytest.mark.parametrize("feels_its_cable", [False, True])
def test_energy_changes_by_the_power_of_the_carriers_less_what_is_dissipated(rng, feels_its_cable):
    system = SystemParameters(load_drag=0.8, load_angular_drag=0.05)
    dynamics = LOADED if feels_its_cable else CarrierDynamicsConfig()
    diagram = loop(system, carrier_dynamics=dynamics)
    context = diagram.CreateDefaultContext()
    set_equilibrium(diagram, context)
    for name, first in (("load_plant", 7), ("carrier_dynamics", 12)):  # velocities come last
        own = diagram.GetSubsystemByName(name).GetMyMutableContextFromRoot(context)
        state = own.get_continuous_state_vector().CopyToVector()
        state[first:] += rng.normal(0, 0.3, len(state) - first)
        own.SetContinuousState(state)
    expected = power(system, diagram, context, feels_its_cable)
    rates = diagram.EvalTimeDerivatives(context).CopyToVector()
    state = context.get_continuous_state_vector().CopyToVector()

    def energy(time):
        context.SetContinuousState(state + time * rates)
        return sum(energies(diagram, context))

    np.testing.assert_allclose(difference(energy, 0.0, 1e-4), expected, rtol=1e-8, atol=0)
    assert abs(expected) > 0.1


def test_a_diagram_around_the_loop_has_its_energy_by_the_functions():
    builder = DiagramBuilder()
    inner = builder.AddSystem(loop(SystemParameters()))
    plant, _ = free_bodies([2.0])
    builder.AddNamedSystem("pod", plant)
    outer = builder.Build()
    context = outer.CreateDefaultContext()
    set_equilibrium(inner, inner.GetMyMutableContextFromRoot(context))
    plant.SetVelocities(plant.GetMyMutableContextFromRoot(context), [0, 0, 0, 3.0, 0, 0])
    own = inner.CalcKineticEnergy(inner.GetMyContextFromRoot(context))
    assert own > 0.05
    assert kinetic_energy(outer, context) == pytest.approx(own + 9.0, rel=1e-12)
    assert inner.EvalKineticEnergy(inner.GetMyContextFromRoot(context)) == own


def test_energies_of_a_converted_loop_are_asked_of_the_loop():
    diagram = loop(SystemParameters())
    made = diagram.ToAutoDiffXd()
    with pytest.raises(ScenarioError, match="converted or cloned: ask the loop that"):
        kinetic_energy(made, made.CreateDefaultContext())
    clone, context = diagram.Clone(), diagram.CreateDefaultContext()
    own = clone.CreateDefaultContext()
    own.SetTimeStateAndParametersFrom(context)
    assert kinetic_energy(clone, own) == kinetic_energy(diagram, context) > 0


def test_potential_energy_of_a_loop_at_rest_is_that_of_load_and_stretched_cables():
    diagram = loop(SystemParameters())
    context = diagram.CreateDefaultContext()
    set_equilibrium(diagram, context)
    height = output(diagram, context, "load_state")[6]
    stretched = (output(diagram, context, "tensions") ** 2).sum() / (2 * 500.0)
    expected = 9.81 * height + stretched
    assert diagram.CalcPotentialEnergy(context) == pytest.approx(expected, rel=1e-9)
    assert diagram.EvalPotentialEnergy(context) == diagram.CalcPotentialEnergy(context)
