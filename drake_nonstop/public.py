"""The public names, each with the module that it is from: `import drake_nonstop` offers them.

Type checkers read this file as it is. `drake_nonstop` reads it for the module of a name, and
imports no other. What else a box can be is imported from the box's file, such as
`drake_nonstop.blocks.phase`, and all else from its room.
"""

# isort: off
# This is the order of the reference.

# What a run is.
from drake_nonstop.scenario.schema import Scenario as Scenario
from drake_nonstop.scenario.loading import (
    load_scenario as load_scenario,
    parse_scenario as parse_scenario,
    dump_scenario as dump_scenario,
    scenario_names as scenario_names,
)
from drake_nonstop.scenario.overrides import changed as changed
from drake_nonstop.scenario.run_limits import RunLimits as RunLimits
from drake_nonstop.scenario.scene_config import SceneConfig as SceneConfig
from drake_nonstop.model.aircraft import AircraftParameters as AircraftParameters
from drake_nonstop.model.system import Model as Model, SystemParameters as SystemParameters
from drake_nonstop.validation import (
    ScenarioError as ScenarioError,
    ScenarioWarning as ScenarioWarning,
)

# Blocks of one's own, and those that they build on.
from drake_nonstop.model.block import Block as Block
from drake_nonstop.systems.block import LeafBlock as LeafBlock
from drake_nonstop.model.pattern import InternalForcePattern as InternalForcePattern
from drake_nonstop.systems.point_forces import PointForces as PointForces
from drake_nonstop.mechanics.signal_layouts import Layout as Layout, Part as Part
from drake_nonstop.mechanics.reference_preview import ReferencePreview as ReferencePreview
from drake_nonstop.blocks.along_trajectory import LoadTrajectory as LoadTrajectory
from drake_nonstop.planning.carriers import (
    carrier_motion as carrier_motion,
    carrier_speeds as carrier_speeds,
    cable_tensions as cable_tensions,
    carrier_distances as carrier_distances,
    flight_margins as flight_margins,
)
from drake_nonstop.planning.problem_config import AircraftLimits as AircraftLimits
from drake_nonstop.planning.diagnostics import Diagnostics as Diagnostics

# The default block of each box, and those that pages use.
from drake_nonstop.blocks.load_trajectory import RestToRest as RestToRest
from drake_nonstop.blocks.load_feedback import (
    IdealFeedback as IdealFeedback,
    NoisyFeedback as NoisyFeedback,
    NoisyFeedbackConfig as NoisyFeedbackConfig,
)
from drake_nonstop.blocks.wrench_controller import WrenchController as WrenchController
from drake_nonstop.blocks.optimization_layer import (
    RecedingHorizonOptimizer as RecedingHorizonOptimizer,
    PaperLayer as PaperLayer,
    NlpLayer as NlpLayer,
    NlpLayerConfig as NlpLayerConfig,
    ConstantParameters as ConstantParameters,
    ConstantParametersConfig as ConstantParametersConfig,
)
from drake_nonstop.blocks.phase import ShapedPhase as ShapedPhase
from drake_nonstop.blocks.internal_force import PlannedInternalForce as PlannedInternalForce
from drake_nonstop.blocks.force_distribution import CableForceDistribution as CableForceDistribution
from drake_nonstop.blocks.carrier_trajectory import CarrierTrajectory as CarrierTrajectory
from drake_nonstop.blocks.carrier_controller import FeedforwardCarrierPid as FeedforwardCarrierPid
from drake_nonstop.blocks.carrier_dynamics import CarrierDynamics as CarrierDynamics
from drake_nonstop.blocks.cables import Cables as Cables
from drake_nonstop.blocks.load_disturbance import (
    NoDisturbance as NoDisturbance,
    DisturbanceForceConfig as DisturbanceForceConfig,
)
from drake_nonstop.blocks.wind import StillAir as StillAir
from drake_nonstop.blocks.wind_estimator import KnownWind as KnownWind
from drake_nonstop.blocks.load_plant import LoadPlant as LoadPlant

# Put together.
from drake_nonstop.diagrams.nonstop import make_nonstop as make_nonstop, make_blocks as make_blocks
from drake_nonstop.systems.wiring import (
    connect_by_name as connect_by_name,
    connect_remaining as connect_remaining,
)
from drake_nonstop.blocks.sample_and_hold import add_sample_and_hold as add_sample_and_hold
from drake_nonstop.systems.compiled_loop import CompiledLoop as CompiledLoop
from drake_nonstop.systems.compiled_system import CompiledSystem as CompiledSystem
from drake_nonstop.loop.start import (
    set_equilibrium as set_equilibrium,
    set_default_equilibrium as set_default_equilibrium,
)
from drake_nonstop.loop.step import (
    largest_step as largest_step,
    with_largest_step as with_largest_step,
)
from drake_nonstop.loop.parameters import (
    set_parameter as set_parameter,
    get_parameter as get_parameter,
)

# Simulated, judged.
from drake_nonstop.run.simulate import simulate as simulate
from drake_nonstop.run.verify_step import verify_step as verify_step
from drake_nonstop.run.many import simulate_many as simulate_many
from drake_nonstop.run.make_simulator import make_simulator as make_simulator
from drake_nonstop.run.run import (
    Run as Run,
    RunStopped as RunStopped,
    RunInterrupted as RunInterrupted,
    RunsInterrupted as RunsInterrupted,
    StepAction as StepAction,
)
from drake_nonstop.run.recording import LogSignals as LogSignals
from drake_nonstop.run.metrics import compute_metrics as compute_metrics
from drake_nonstop.run.make_gym_env import (
    make_gym_env as make_gym_env,
    make_gym_vec_env as make_gym_vec_env,
)
from drake_nonstop.run.outcome import RunOutcome as RunOutcome
from drake_nonstop.analysis.aircraft_margins import aircraft_margins as aircraft_margins
from drake_nonstop.analysis.stability import linearize as linearize
from drake_nonstop.analysis.verdict import check_scenario as check_scenario

# Compared, designed.
from drake_nonstop.studies.results_folder import write_results as write_results
from drake_nonstop.studies.study import study as study, Study as Study
from drake_nonstop.studies.presets import (
    ablate as ablate,
    sweep as sweep,
    robustness as robustness,
    read_grid as read_grid,
)
from drake_nonstop.studies.workers import SerialExecutor as SerialExecutor
from drake_nonstop.studies.journal import StudyInterrupted as StudyInterrupted
from drake_nonstop.studies.design import design as design
from drake_nonstop.studies.design_request import (
    read_request as read_request,
    DesignRequest as DesignRequest,
)

# Watched.
from drake_nonstop.view.drawing import draw_diagram as draw_diagram
from drake_nonstop.view.geometry import AddGeometry as AddGeometry
from drake_nonstop.view.nonstop_visualizer import (
    NonstopVisualizer as NonstopVisualizer,
    show_in as show_in,
)
from drake_nonstop.view.meshcat_server import start_meshcat as start_meshcat
from drake_nonstop.view.live import run_live as run_live
from drake_nonstop.view.replay import record_replay as record_replay
from drake_nonstop.view.video import record_video as record_video
from drake_nonstop.view.progress import (
    TaskProgress as TaskProgress,
    RunProgress as RunProgress,
)
