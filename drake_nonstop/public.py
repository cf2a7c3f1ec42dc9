"""The public names, in the order of the figure.

What a run is, the boxes and what they can be swapped for, and how they are put together, simulated
and judged. `drake_nonstop` has them all.
"""

import sys
from typing import TYPE_CHECKING, Any

from drake_nonstop.blocks.load_trajectory import LoadTrajectory
from drake_nonstop.blocks.reference_governor import ReferenceGovernor, ReferenceGovernorConfig
from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.diagrams.compiled_flight import CompiledFlight
from drake_nonstop.diagrams.compiled_loop import CompiledLoop
from drake_nonstop.diagrams.compiled_system import CompiledSystem
from drake_nonstop.diagrams.equilibrium import set_equilibrium
from drake_nonstop.diagrams.loop_derivatives import DerivativeFlight, Sensitivities
from drake_nonstop.diagrams.nonstop import BOXES, make_blocks, make_nonstop
from drake_nonstop.diagrams.parameters import (
    LoopParameter,
    get_parameter,
    parameters,
    set_parameter,
)
from drake_nonstop.mechanics.reference_preview import ReferencePreview, continued_reference
from drake_nonstop.mechanics.signal_layouts import Layout, Part
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import (
    CarouselConfig,
    ConstantSpreadConfig,
    EllipticCarouselConfig,
    HamiltonianCycleConfig,
    LinearPatternConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.scenario.loading import (
    dump_scenario,
    load_scenario,
    parse_scenario,
    scenario_names,
)
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.aircraft_margins import (
    AircraftMargins,
    FlightMargin,
    aircraft_margins,
)
from drake_nonstop.simulation.make_gym_env import make_gym_env
from drake_nonstop.simulation.make_simulator import make_simulator
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.outcome import RunOutcome
from drake_nonstop.simulation.recording import LogSignals
from drake_nonstop.simulation.run import Run, RunInterrupted, RunStopped, StepAction, StepCheck
from drake_nonstop.simulation.simulate import simulate, verify_step
from drake_nonstop.studies.ablation import ablate, read_grid
from drake_nonstop.studies.design import Design, DesignedFormation, design
from drake_nonstop.studies.design_request import DesignRequest, read_request
from drake_nonstop.studies.journal import StudyInterrupted
from drake_nonstop.studies.results_folder import write_results
from drake_nonstop.studies.run_all import SerialExecutor
from drake_nonstop.studies.sweep import Sweep, SweepInterrupted, sweep
from drake_nonstop.studies.sweep_spec import PlannedRun, SweepSpec, read_sweep
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.energy import LoopDiagram, kinetic_energy, potential_energy
from drake_nonstop.systems.point_forces import PointForces
from drake_nonstop.systems.traced_block import TracedBlock
from drake_nonstop.systems.wiring import connect_by_name
from drake_nonstop.validation import ScenarioError, ScenarioWarning
from drake_nonstop.version import __version__
from drake_nonstop.visualization.drawing import draw_diagram
from drake_nonstop.visualization.geometry import AddGeometry, NonstopGeometry
from drake_nonstop.visualization.live import run_live
from drake_nonstop.visualization.meshcat_server import start_meshcat
from drake_nonstop.visualization.nonstop_visualizer import NonstopVisualizer, show_in
from drake_nonstop.visualization.progress import RunProgress, TaskProgress
from drake_nonstop.visualization.replay import record_replay
from drake_nonstop.visualization.rich_display import diagram_html, run_html, sweep_html

__all__ = [  # noqa: RUF022 - in the order of the figure
    # what a run is
    "Scenario",
    "load_scenario",
    "parse_scenario",
    "dump_scenario",
    "scenario_names",
    "RunLimits",
    "AircraftParameters",
    "SystemParameters",
    "HamiltonianCycleConfig",
    "CarouselConfig",
    "SpreadCarouselConfig",
    "EllipticCarouselConfig",
    "ConstantSpreadConfig",
    "LinearPatternConfig",
    "Model",
    "LoadTrajectory",
    "ReferenceGovernor",
    "ReferenceGovernorConfig",
    "ReferencePreview",
    "continued_reference",
    "Outcome",
    "SampleAndHold",
    "PointForces",
    "LeafBlock",
    "TracedBlock",
    "Layout",
    "Part",
    # put together, simulated, judged
    "make_nonstop",
    "make_blocks",
    "connect_by_name",
    "CompiledLoop",
    "CompiledFlight",
    "CompiledSystem",
    "DerivativeFlight",
    "Sensitivities",
    "set_equilibrium",
    "set_parameter",
    "get_parameter",
    "parameters",
    "LoopParameter",
    "simulate",
    "aircraft_margins",
    "AircraftMargins",
    "FlightMargin",
    "make_simulator",
    "make_gym_env",
    "verify_step",
    "StepAction",
    "StepCheck",
    "LogSignals",
    "Run",
    "RunStopped",
    "RunInterrupted",
    "compute_metrics",
    "kinetic_energy",
    "potential_energy",
    "RunOutcome",
    "write_results",
    "ablate",
    "read_grid",
    "design",
    "read_request",
    "DesignRequest",
    "Design",
    "DesignedFormation",
    "sweep",
    "read_sweep",
    "SweepSpec",
    "SerialExecutor",
    "PlannedRun",
    "Sweep",
    "SweepInterrupted",
    "StudyInterrupted",
    "draw_diagram",
    # watched
    "AddGeometry",
    "NonstopGeometry",
    "NonstopVisualizer",
    "show_in",
    "SceneConfig",
    "start_meshcat",
    "run_live",
    "record_replay",
    "RunProgress",
    "TaskProgress",
    "ScenarioError",
    "ScenarioWarning",
    "__version__",
]

# Every block that a box can be, and its config: blocks are listed in their own modules alone.
for _block in (block for box in BOXES.values() for block in box.variants):
    for _name in (_block.__name__, f"{_block.__name__}Config"):
        globals()[_name] = getattr(sys.modules[_block.__module__], _name)
        __all__ += [_name]

# How notebooks show them: figures are drawn in a room above that of runs.
for _shown, _html in ((Run, run_html), (Sweep, sweep_html), (LoopDiagram, diagram_html)):
    setattr(_shown, "_repr_html_", _html)  # noqa: B010 - for type checkers it is no attribute

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Any block or config, for type checkers, which do not run the loop above."""
