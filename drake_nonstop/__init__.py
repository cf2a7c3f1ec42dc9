"""Carriers that must not stop fly a load on cables: the closed loop as Drake systems.

The public names, in the order of the figure: what a run is, the boxes and what they can
be swapped for, and how they are put together, simulated and judged.
"""

from drake_nonstop.ablation import ablate, read_grid
from drake_nonstop.blocks.accumulated_phase import AccumulatedPhase, AccumulatedPhaseConfig
from drake_nonstop.blocks.cable_force_distribution import (
    BoundedTensionDistribution,
    BoundedTensionDistributionConfig,
    CableForceDistribution,
    CableForceDistributionConfig,
)
from drake_nonstop.blocks.cables import (
    Cables,
    CablesConfig,
    IndividualCables,
    IndividualCablesConfig,
)
from drake_nonstop.blocks.carrier_dynamics import CarrierDynamics, CarrierDynamicsConfig
from drake_nonstop.blocks.carrier_pid import (
    CarrierPid,
    CarrierPidConfig,
    FeedforwardCarrierPid,
    FeedforwardCarrierPidConfig,
    TunedCarrierPid,
    TunedCarrierPidConfig,
    TunedFeedforwardCarrierPid,
    TunedFeedforwardCarrierPidConfig,
)
from drake_nonstop.blocks.carrier_trajectory import (
    CarrierTrajectory,
    CarrierTrajectoryConfig,
    InextensibleCarrierTrajectory,
    InextensibleCarrierTrajectoryConfig,
    MeasuredCarrierTrajectory,
    MeasuredCarrierTrajectoryConfig,
)
from drake_nonstop.blocks.constant_parameters import ConstantParameters, ConstantParametersConfig
from drake_nonstop.blocks.desired_state_feedback import (
    DesiredStateFeedback,
    DesiredStateFeedbackConfig,
)
from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.blocks.ideal_carriers import IdealCarriers, IdealCarriersConfig
from drake_nonstop.blocks.ideal_feedback import IdealFeedback, IdealFeedbackConfig
from drake_nonstop.blocks.internal_force_trajectory import (
    InternalForceTrajectory,
    InternalForceTrajectoryConfig,
)
from drake_nonstop.blocks.load_plant import LoadPlant, LoadPlantConfig
from drake_nonstop.blocks.load_trajectory import (
    Circle,
    CircleConfig,
    ConstantVelocityMove,
    ConstantVelocityMoveConfig,
    LoadTrajectory,
    RestToRest,
    RestToRestConfig,
    SampledTrajectory,
    SampledTrajectoryConfig,
    Waypoints,
    WaypointsConfig,
)
from drake_nonstop.blocks.loaded_carrier_dynamics import (
    LoadedCarrierDynamics,
    LoadedCarrierDynamicsConfig,
)
from drake_nonstop.blocks.loaded_carrier_pid import LoadedCarrierPid, LoadedCarrierPidConfig
from drake_nonstop.blocks.multibody_load_plant import MultibodyLoadPlant, MultibodyLoadPlantConfig
from drake_nonstop.blocks.no_disturbance import NoDisturbance, NoDisturbanceConfig
from drake_nonstop.blocks.noisy_feedback import NoisyFeedback, NoisyFeedbackConfig
from drake_nonstop.blocks.nonstop_optimizer import NonstopOptimizer, NonstopOptimizerConfig
from drake_nonstop.blocks.nonstop_visualizer import NonstopVisualizer
from drake_nonstop.blocks.printed_phase import PrintedPhase, PrintedPhaseConfig
from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.blocks.wind import Wind, WindConfig
from drake_nonstop.blocks.wrench_controller import (
    GeometricPd,
    GeometricPdConfig,
    PrintedWrenchController,
    PrintedWrenchControllerConfig,
    TunedWrenchController,
    TunedWrenchControllerConfig,
    WrenchController,
    WrenchControllerConfig,
)
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.drawing import draw_diagram
from drake_nonstop.equilibrium import set_equilibrium
from drake_nonstop.live import run_live
from drake_nonstop.metrics import compute_metrics
from drake_nonstop.pattern import (
    CarouselConfig,
    HamiltonianCycleConfig,
    LinearPatternConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.replay import record_replay
from drake_nonstop.results import write_results
from drake_nonstop.scenario import (
    Scenario,
    dump_scenario,
    load_scenario,
    parse_scenario,
    scenario_names,
)
from drake_nonstop.scene import SceneConfig, start_meshcat
from drake_nonstop.simulate import Run, RunInterrupted, RunStopped, Then, simulate
from drake_nonstop.speed_program import Outcome
from drake_nonstop.sweep import Sweep, SweepInterrupted, sweep
from drake_nonstop.sweep_spec import PlannedRun, SweepSpec, read_sweep
from drake_nonstop.system import Model, System
from drake_nonstop.traced_block import Equations, TracedBlock
from drake_nonstop.validation import ScenarioError, ScenarioWarning
from drake_nonstop.version import __version__

__all__ = [  # noqa: RUF022 - in the order of the figure
    # what a run is
    "Scenario",
    "load_scenario",
    "parse_scenario",
    "dump_scenario",
    "scenario_names",
    "System",
    "HamiltonianCycleConfig",
    "CarouselConfig",
    "SpreadCarouselConfig",
    "LinearPatternConfig",
    "Model",
    # the boxes of the figure, each with its config
    "LoadTrajectory",
    "RestToRest",
    "RestToRestConfig",
    "ConstantVelocityMove",
    "ConstantVelocityMoveConfig",
    "Waypoints",
    "WaypointsConfig",
    "Circle",
    "CircleConfig",
    "SampledTrajectory",
    "SampledTrajectoryConfig",
    "IdealFeedback",
    "IdealFeedbackConfig",
    "DesiredStateFeedback",
    "DesiredStateFeedbackConfig",
    "NoisyFeedback",
    "NoisyFeedbackConfig",
    "SampleAndHold",
    "WrenchController",
    "WrenchControllerConfig",
    "PrintedWrenchController",
    "PrintedWrenchControllerConfig",
    "Equations",
    "FusedPlant",
    "GeometricPd",
    "GeometricPdConfig",
    "TunedWrenchController",
    "TunedWrenchControllerConfig",
    "NonstopOptimizer",
    "NonstopOptimizerConfig",
    "Outcome",
    "ConstantParameters",
    "ConstantParametersConfig",
    "AccumulatedPhase",
    "AccumulatedPhaseConfig",
    "PrintedPhase",
    "PrintedPhaseConfig",
    "InternalForceTrajectory",
    "InternalForceTrajectoryConfig",
    "CableForceDistribution",
    "CableForceDistributionConfig",
    "BoundedTensionDistribution",
    "BoundedTensionDistributionConfig",
    "CarrierTrajectory",
    "CarrierTrajectoryConfig",
    "InextensibleCarrierTrajectory",
    "InextensibleCarrierTrajectoryConfig",
    "MeasuredCarrierTrajectory",
    "MeasuredCarrierTrajectoryConfig",
    "CarrierPid",
    "CarrierPidConfig",
    "FeedforwardCarrierPid",
    "FeedforwardCarrierPidConfig",
    "TracedBlock",
    "TunedCarrierPid",
    "TunedCarrierPidConfig",
    "TunedFeedforwardCarrierPid",
    "TunedFeedforwardCarrierPidConfig",
    "LoadedCarrierPid",
    "LoadedCarrierPidConfig",
    "CarrierDynamics",
    "CarrierDynamicsConfig",
    "LoadedCarrierDynamics",
    "LoadedCarrierDynamicsConfig",
    "IdealCarriers",
    "IdealCarriersConfig",
    "Cables",
    "CablesConfig",
    "IndividualCables",
    "IndividualCablesConfig",
    "NoDisturbance",
    "NoDisturbanceConfig",
    "Wind",
    "WindConfig",
    "LoadPlant",
    "LoadPlantConfig",
    "MultibodyLoadPlant",
    "MultibodyLoadPlantConfig",
    # put together, simulated, judged
    "make_nonstop",
    "set_equilibrium",
    "simulate",
    "Then",
    "Run",
    "RunStopped",
    "RunInterrupted",
    "compute_metrics",
    "write_results",
    "ablate",
    "read_grid",
    "sweep",
    "read_sweep",
    "SweepSpec",
    "PlannedRun",
    "Sweep",
    "SweepInterrupted",
    "draw_diagram",
    # watched
    "NonstopVisualizer",
    "SceneConfig",
    "start_meshcat",
    "run_live",
    "record_replay",
    "ScenarioError",
    "ScenarioWarning",
    "__version__",
]
