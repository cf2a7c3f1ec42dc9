"""The closed loop as one block of a bigger diagram: a sensor pod hangs below the load.

The pod is a body of the user's own MultibodyPlant. The loop's box for disturbances is left
out, so that it has an input port `disturbance_wrench`; the hose between load and pod reads the
load's state from the loop and pulls at both.
"""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.visualization import AddDefaultVisualization

from drake_nonstop import (
    NonstopVisualizer,
    load_scenario,
    make_nonstop,
    set_equilibrium,
    start_meshcat,
    with_largest_step,
)

LENGTH, STIFFNESS, DAMPING = 0.5, 40.0, 0.8  # m, N/m, N s/m, of the hose
POD_MASS, GRAVITY = 0.05, 9.81  # kg, m/s²


class Hose(LeafSystem):
    """A spring and damper from the load's centre of mass to the pod, which can only pull."""

    def __init__(self, plant: MultibodyPlant):
        super().__init__()
        self._pod = plant.GetBodyByName("pod").index()
        self._load_state = self.DeclareVectorInputPort("load_state", 13)
        self._pod_state = self.DeclareVectorInputPort("pod_state", 13)
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self._calc_wrench)
        self.DeclareAbstractOutputPort(
            "pod_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            self._calc_pod_forces,
        )

    def _pull(self, context: Context) -> np.ndarray:
        """The force (3,) on the load, in W."""
        load, pod = self._load_state.Eval(context), self._pod_state.Eval(context)
        stretch, rate = pod[4:7] - load[4:7], pod[10:13] - load[10:13]
        length = np.linalg.norm(stretch)
        direction = stretch / length
        tension = STIFFNESS * (length - LENGTH) + DAMPING * direction @ rate
        return max(tension, 0.0) * (length > LENGTH) * direction

    def _calc_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([0, 0, 0, *self._pull(context)])

    def _calc_pod_forces(self, context: Context, output: AbstractValue) -> None:
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._pod
        force.F_Bq_W = SpatialForce(tau=np.zeros(3), f=-self._pull(context))
        output.set_value([force])


def add_pod(builder: DiagramBuilder) -> MultibodyPlant:
    """A plant of the user's own, with a ball in it, and its scene graph."""
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    body = plant.AddRigidBody("pod", SpatialInertia.SolidSphereWithMass(POD_MASS, 0.06))
    plant.RegisterVisualGeometry(body, RigidTransform(), Sphere(0.06), "pod", [0.1, 0.5, 0.9, 1])
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -GRAVITY])
    plant.Finalize()
    return plant


def main(duration: float = 15.0, show: bool = False) -> None:
    """Flies the quintic task with the pod below the load; `show` asks for Meshcat."""
    scenario = load_scenario("quintic")
    builder = DiagramBuilder()
    plant = add_pod(builder)
    loop = builder.AddSystem(make_nonstop(scenario, load_disturbance=None))
    hose = builder.AddSystem(Hose(plant))
    builder.Connect(loop.GetOutputPort("load_state"), hose.GetInputPort("load_state"))
    builder.Connect(plant.get_state_output_port(), hose.GetInputPort("pod_state"))
    builder.Connect(
        hose.GetOutputPort("disturbance_wrench"), loop.GetInputPort("disturbance_wrench")
    )
    builder.Connect(hose.GetOutputPort("pod_forces"), plant.get_applied_spatial_force_input_port())
    if show:
        meshcat = start_meshcat()
        print("watch it at", meshcat.web_url())
        AddDefaultVisualization(builder, meshcat)
        NonstopVisualizer.AddToBuilder(builder, loop, scenario, meshcat)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()

    # The pod starts where it hangs at rest, and the loop where it holds load and pod.
    pod = np.array([1.0, 0, 0, 0, 0, 0, -LENGTH - POD_MASS * GRAVITY / STIFFNESS, *np.zeros(6)])
    plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), pod)
    set_equilibrium(loop, loop.GetMyMutableContextFromRoot(context))
    config = with_largest_step(scenario.simulator_config, diagram, context)
    ApplySimulatorConfig(config, simulator)
    if show:
        simulator.set_target_realtime_rate(1.0)
    simulator.AdvanceTo(duration)

    loop_context = loop.GetMyContextFromRoot(context)
    load, reference = (
        loop.GetOutputPort(name).Eval(loop_context)[4:7] for name in ("load_state", "reference")
    )
    pod = plant.GetPositions(plant.GetMyContextFromRoot(context))[4:]
    print(f"final load error  {1e3 * np.linalg.norm(load - reference):.2f} mm")
    print(f"pod below load    {load[2] - pod[2]:.3f} m")


if __name__ == "__main__":
    main(show=True)
