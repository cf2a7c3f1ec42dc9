"""The public names, in the order of the figure: each is written here, and nowhere else.

What a run is, how its boxes are put together, simulated, judged and watched, and what each box can
be. `drake_nonstop` has them all. They are written out for type checkers.
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
from drake_nonstop.scenario.run_limits import RunLimits as RunLimits
from drake_nonstop.scenario.obstacles import (
    BoxConfig as BoxConfig,
    SphereConfig as SphereConfig,
    GroundConfig as GroundConfig,
)
from drake_nonstop.model.aircraft import AircraftParameters as AircraftParameters
from drake_nonstop.model.system import SystemParameters as SystemParameters
from drake_nonstop.model.pattern import (
    HamiltonianCycleConfig as HamiltonianCycleConfig,
    CarouselConfig as CarouselConfig,
    SpreadCarouselConfig as SpreadCarouselConfig,
    EllipticCarouselConfig as EllipticCarouselConfig,
    ConstantSpreadConfig as ConstantSpreadConfig,
    LinearPatternConfig as LinearPatternConfig,
)
from drake_nonstop.model.system import Model as Model
from drake_nonstop.blocks.along_trajectory import LoadTrajectory as LoadTrajectory
from drake_nonstop.blocks.reference_governor import (
    ReferenceGovernor as ReferenceGovernor,
    ReferenceGovernorConfig as ReferenceGovernorConfig,
)
from drake_nonstop.mechanics.reference_preview import (
    ReferencePreview as ReferencePreview,
    continued_reference as continued_reference,
)
from drake_nonstop.planning.diagnostics import Outcome as Outcome
from drake_nonstop.planning.carriers import (
    carrier_motion as carrier_motion,
    carrier_speeds as carrier_speeds,
    cable_tensions as cable_tensions,
    carrier_distances as carrier_distances,
    flight_margins as flight_margins,
)
from drake_nonstop.blocks.sample_and_hold import SampleAndHold as SampleAndHold
from drake_nonstop.systems.point_forces import PointForces as PointForces
from drake_nonstop.systems.block import LeafBlock as LeafBlock
from drake_nonstop.systems.equations import BetweenSamples as BetweenSamples
from drake_nonstop.model.block import Block as Block
from drake_nonstop.mechanics.signal_layouts import Layout as Layout, Part as Part

# Put together, simulated, judged.
from drake_nonstop.diagrams.nonstop import make_nonstop as make_nonstop, make_blocks as make_blocks
from drake_nonstop.systems.wiring import (
    connect_by_name as connect_by_name,
    connect_remaining as connect_remaining,
)
from drake_nonstop.blocks.sample_and_hold import add_sample_and_hold as add_sample_and_hold
from drake_nonstop.systems.compiled_flight import CompiledFlight as CompiledFlight
from drake_nonstop.systems.compiled_loop import CompiledLoop as CompiledLoop
from drake_nonstop.systems.compiled_system import CompiledSystem as CompiledSystem
from drake_nonstop.systems.sensitivities import Sensitivities as Sensitivities
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
from drake_nonstop.run.simulate import simulate as simulate
from drake_nonstop.run.many import simulate_many as simulate_many
from drake_nonstop.analysis.aircraft_margins import (
    aircraft_margins as aircraft_margins,
    AircraftMargins as AircraftMargins,
)
from drake_nonstop.analysis.flight_envelope import FlightMargin as FlightMargin
from drake_nonstop.run.make_simulator import make_simulator as make_simulator
from drake_nonstop.run.make_gym_env import (
    make_gym_env as make_gym_env,
    make_gym_vec_env as make_gym_vec_env,
)
from drake_nonstop.run.verify_step import verify_step as verify_step
from drake_nonstop.run.run import StepAction as StepAction
from drake_nonstop.run.recording import LogSignals as LogSignals
from drake_nonstop.run.run import (
    Run as Run,
    RunStopped as RunStopped,
    RunInterrupted as RunInterrupted,
    RunsInterrupted as RunsInterrupted,
)
from drake_nonstop.run.metrics import compute_metrics as compute_metrics
from drake_nonstop.systems.energy import (
    kinetic_energy as kinetic_energy,
    potential_energy as potential_energy,
)
from drake_nonstop.analysis.limit import RunOutcome as RunOutcome
from drake_nonstop.studies.results_folder import write_results as write_results
from drake_nonstop.studies.ablation import ablate as ablate, read_grid as read_grid
from drake_nonstop.studies.design import design as design, Design as Design
from drake_nonstop.studies.design_request import (
    read_request as read_request,
    DesignRequest as DesignRequest,
)
from drake_nonstop.studies.designed_formation import DesignedFormation as DesignedFormation
from drake_nonstop.studies.sweep import sweep as sweep
from drake_nonstop.studies.sweep_spec import read_sweep as read_sweep, SweepSpec as SweepSpec
from drake_nonstop.studies.run_all import SerialExecutor as SerialExecutor
from drake_nonstop.studies.sweep_spec import PlannedRun as PlannedRun
from drake_nonstop.studies.sweep import Sweep as Sweep, SweepInterrupted as SweepInterrupted
from drake_nonstop.studies.journal import StudyInterrupted as StudyInterrupted
from drake_nonstop.view.drawing import draw_diagram as draw_diagram

# Watched, and what is raised.
from drake_nonstop.view.geometry import (
    AddGeometry as AddGeometry,
    NonstopGeometry as NonstopGeometry,
)
from drake_nonstop.view.nonstop_visualizer import (
    NonstopVisualizer as NonstopVisualizer,
    show_in as show_in,
)
from drake_nonstop.scenario.scene_config import SceneConfig as SceneConfig
from drake_nonstop.view.meshcat_server import start_meshcat as start_meshcat
from drake_nonstop.view.live import run_live as run_live
from drake_nonstop.view.replay import record_replay as record_replay
from drake_nonstop.view.video import record_video as record_video
from drake_nonstop.view.progress import (
    RunProgress as RunProgress,
    TaskProgress as TaskProgress,
)
from drake_nonstop.validation import (
    StrictFields as StrictFields,
    ScenarioError as ScenarioError,
    ScenarioWarning as ScenarioWarning,
)

# What each box can be: the names of its module's `__all__`.
from drake_nonstop.blocks.load_trajectory import *
from drake_nonstop.blocks.load_feedback import *
from drake_nonstop.blocks.wrench_controller import *
from drake_nonstop.blocks.optimization_layer import *
from drake_nonstop.blocks.phase import *
from drake_nonstop.blocks.internal_force import *
from drake_nonstop.blocks.force_distribution import *
from drake_nonstop.blocks.carrier_trajectory import *
from drake_nonstop.blocks.carrier_controller import *
from drake_nonstop.blocks.carrier_dynamics import *
from drake_nonstop.blocks.cables import *
from drake_nonstop.blocks.load_disturbance import *
from drake_nonstop.blocks.wind import *
from drake_nonstop.blocks.wind_estimator import *
from drake_nonstop.blocks.load_plant import *

# How notebooks show them: figures are drawn in a room above that of runs.
from drake_nonstop.systems.energy import LoopDiagram as _LoopDiagram
from drake_nonstop.view import rich_display as _rich_display

for _shown, _html in (
    (Scenario, _rich_display.scenario_html),
    (Run, _rich_display.run_html),
    (Sweep, _rich_display.sweep_html),
    (_LoopDiagram, _rich_display.diagram_html),
):
    setattr(_shown, "_repr_html_", _html)  # noqa: B010 - for type checkers it is no attribute
