"""Attachments, smooth motions, difference quotients and ports, for several test files."""

import signal
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aircraft_runs import made_up
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import Value
from pydrake.math import RollPitchYaw_, RotationMatrix
from pydrake.systems.framework import Context, Diagram, LeafSystem, PortDataType, System

from drake_nonstop import Block, Model, NlpLayerConfig, Scenario, SystemParameters
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.model.pattern import HamiltonianCycleConfig

INERTIA = np.array([[0.014, 0.001, -0.0005], [0.001, 0.011, 0.002], [-0.0005, 0.002, 0.017]])

# The paper's gains (Table I), by the names of `wrench_and_rate`.
GAINS = {
    "position_gain": 5.0,
    "velocity_gain": 2.0,
    "position_integral_gain": 0.9,
    "orientation_gain": 0.5,
    "angular_velocity_gain": 0.06,
    "orientation_integral_gain": 0.1,
}


def nightly_beyond(count: int, nightly_class: str, cases: Iterable[Any]) -> list[Any]:
    """Cases of a test, of which the first few are for `make test`, the others for `make nightly`.

    A tuple has the values of several arguments.
    """
    mark = pytest.mark.nightly(nightly_class)
    listed = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*c, marks=() if k < count else mark) for k, c in enumerate(listed)]


@dataclass
class QuadraticDragConfig:
    """It has no parameters."""


class QuadraticDrag(Block):
    """Drag of the load, whose equation has no derivative at rest."""

    reads, makes = ("load_state",), ("disturbance_wrench",)

    @staticmethod
    def equations(load_state):
        velocity = LoadState.view(load_state).velocity
        return np.concatenate([np.zeros(3), -0.3 * norm(velocity) * velocity])


def sizes_of(box: Any, n: int, m: int) -> dict[str, int | None]:
    """The sizes of a box's signals for n carriers and m coordinates; None: one is abstract."""
    return {s: None if layout is None else layout.count(n, m) for s, layout in box.signals.items()}


def regular(n: int, radius: float = 0.75) -> NDArray:
    """The corners (n, 3) of a level regular polygon."""
    angles = 2 * np.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])


def irregular(n: int) -> NDArray:
    """A level polygon with unequal sides, (n, 3)."""
    rng = np.random.default_rng(n)
    angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.25, 0.25, n)) / n
    radii = rng.uniform(0.5, 1.0, n)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(n)])


def spatial(n: int) -> NDArray:
    """The irregular polygon with its corners at unequal heights, (n, 3)."""
    heights = np.random.default_rng(n + 100).uniform(-0.3, 0.3, n)
    return irregular(n) + np.column_stack([np.zeros((n, 2)), heights])


SHAPES = {
    f"{make.__name__}-{n}": make(n) for make in (regular, irregular, spatial) for n in range(3, 9)
}


def over_shapes(check: Callable[[NDArray, np.random.Generator], None]) -> Callable:
    """One test of all shapes, of a check of attachments (n, 3) and of random numbers."""

    def over_all(rng):
        for name, attachments in SHAPES.items():
            try:
                check(attachments, rng)
            except AssertionError as error:
                raise AssertionError(f"{name}: {error}") from error

    return over_all


def difference(function: Callable[[float], NDArray], time: float, step: float = 1e-3) -> NDArray:
    """The derivative by a central difference of fourth order.

    On motions of order 1 in value and frequency its error is about 1e-12: h⁴ = 1e-12 from
    the truncation, 1e-16 / h = 1e-13 from rounding.
    """
    return (
        8 * (np.asarray(function(time + step)) - np.asarray(function(time - step)))
        - (np.asarray(function(time + 2 * step)) - np.asarray(function(time - 2 * step)))
    ) / (12 * step)


def rates_by_differences(
    reference: Callable[[float], NDArray], time: float, step: float = 1e-3
) -> NDArray:
    """[ω, v, ω̇, a, jerk, angular jerk, snap] (21,) by differences of what is below them."""
    S = difference(lambda t: rotation(reference(t)[:4]), time, step)
    S = S @ rotation(reference(time)[:4]).T
    rates = difference(reference, time, step)
    spin = [S[2, 1], S[0, 2], S[1, 0]]
    return np.concatenate([spin, rates[4:13], rates[16:19], rates[13:16], rates[19:]])


class Motion:
    """A smooth motion of a rigid body, with Drake's AutoDiffXd as the source of its rates."""

    def __init__(self, seed: int):
        rng = np.random.default_rng(seed)
        self._middle = rng.uniform(-0.4, 0.4, 6)
        self._size = rng.uniform(0.2, 0.5, 6)
        self._frequency = rng.uniform(0.6, 1.6, 6)
        self._start = rng.uniform(0, 2 * np.pi, 6)

    def _coordinates(self, time: float | AutoDiffXd, order: int = 0) -> NDArray:
        """[roll, pitch, yaw, x, y, z], or their derivatives of that order."""
        sines = np.sin(self._frequency * time + self._start + order * np.pi / 2)
        return self._size * self._frequency**order * sines + (self._middle if order == 0 else 0)

    def reference(self, time: float) -> NDArray:
        """[quaternion, position, ω, v, ω̇, a, jerk] (22,), in W."""
        now = AutoDiffXd(time, [1.0])
        angles = RollPitchYaw_[AutoDiffXd](self._coordinates(now)[:3])
        omega = angles.CalcAngularVelocityInParentFromRpyDt(self._coordinates(now, 1)[:3])
        quaternion = angles.ToQuaternion()
        wxyz = np.array([quaternion.w(), quaternion.x(), quaternion.y(), quaternion.z()])
        place, velocity, acceleration, jerk = (self._coordinates(time, k)[3:] for k in range(4))
        rates = ExtractGradient(omega)[:, 0], acceleration, jerk
        turning = ExtractValue(omega)[:, 0], velocity
        return np.concatenate([ExtractValue(wxyz)[:, 0], place, *turning, *rates])

    def state(self, time: float) -> NDArray:
        """[quaternion, position, ω, v] (13,), in W."""
        return self.reference(time)[:13]


def rotation(quaternion: NDArray) -> NDArray:
    """R (3, 3) of a quaternion w x y z of any norm, by Drake."""
    return RotationMatrix(Quaternion(quaternion / np.linalg.norm(quaternion))).matrix()


def model(n: int = 4, control_period: float = 0.0, **system: object) -> Model:
    """A model of n cables at the corners of a regular polygon, phases 2π (k − 1) / n."""
    fields = {"attachments": regular(n).tolist(), "load_inertia": INERTIA.tolist()} | system
    return Model(SystemParameters(**fields), HamiltonianCycleConfig(), control_period)


def fix(block: LeafSystem, context: Context, **inputs: NDArray) -> None:
    """Fixes the inputs of those names; a second call replaces the values of the first."""
    for name, value in inputs.items():
        block.GetInputPort(name).FixValue(context, value)


def output(block: LeafSystem, context: Context, name: str) -> NDArray:
    """A copy of the output of that name."""
    return block.GetOutputPort(name).Eval(context).copy()


def sizes_of_ports(block: System, kind: str = "output") -> dict[str, int | None]:
    """The sizes of a block's ports by their names, by Drake; None: one is abstract."""
    count = getattr(block, f"num_{kind}_ports")()
    ports = [getattr(block, f"get_{kind}_port")(k) for k in range(count)]
    is_vector = [port.get_data_type() == PortDataType.kVectorValued for port in ports]
    return {p.get_name(): p.size() if v else None for p, v in zip(ports, is_vector, strict=True)}


def connections(diagram: Diagram) -> list[str]:
    """The wires "block.output -> block.input" inside of a diagram, by Drake."""
    return [
        f"{maker.get_name()}.{maker.get_output_port(output).get_name()} -> "
        f"{reader.get_name()}.{reader.get_input_port(port).get_name()}"
        for (reader, port), (maker, output) in diagram.connection_map().items()
    ]


def vector_outputs(block: System) -> list[str]:
    """The names of the output ports, but for abstract ones."""
    return [name for name, size in sizes_of_ports(block).items() if size is not None]


def outputs(
    block: LeafSystem, state: NDArray | None = None, time: float = 0.0, **inputs: NDArray
) -> dict[str, NDArray]:
    """All outputs by their names, for a continuous state, a time and inputs."""
    context = block.CreateDefaultContext()
    context.SetTime(time)
    if state is not None:
        context.SetContinuousState(state)
    fix(block, context, **inputs)
    return {name: output(block, context, name) for name in vector_outputs(block)}


def assert_same_run(run, expected, tolerance=0.0):
    """Signals and those of steps, but for wall times, to a share of their largest; ends."""
    np.testing.assert_array_equal(run.time, expected.time)
    np.testing.assert_allclose(run.steps["time"], expected.steps["time"], atol=1e-12)
    for of_one, of_other in ((run.signals, expected.signals), (run.steps, expected.steps)):
        assert of_one.keys() == of_other.keys()
        for name in of_other.keys() - {"time", "solve_time"}:
            atol = tolerance * (1 + np.abs(of_other[name]).max(initial=0.0))
            np.testing.assert_allclose(of_one[name], of_other[name], 0, atol, err_msg=name)
    ends = [(each.stopped, each.step, each.unresolved) for each in (run, expected)]
    assert ends[0] == ends[1]


def circling_run(n=4, duration=0.5, cable_length=0.8):
    """A made-up run of `n` carriers that circle above a turning load on its way along x.

    All that a scene shows changes all the time, marks and tensions among it.
    """
    time = np.arange(0, duration + 1e-9, 0.01)
    load = np.zeros((len(time), 13))
    load[:, 0], load[:, 3] = np.cos(time / 4), np.sin(time / 4)
    load[:, 4] = 0.7 * time
    turns = time[:, None] + 2 * np.pi * np.arange(n) / n
    positions = np.stack([np.cos(turns), np.sin(turns), np.full(turns.shape, cable_length)], 2)
    positions += load[:, None, 4:7]
    velocities = np.stack([-np.sin(turns), np.cos(turns), np.zeros(turns.shape)], 2)
    velocities *= (1 + 0.3 * np.sin(5 * turns))[..., None]
    system = SystemParameters(attachments=regular(n, 1).tolist(), cable_length=cable_length)
    layer = NlpLayerConfig(speed_bound=0.7)
    return made_up(
        Scenario(system=system, simulation_duration=duration, optimization_layer=layer),
        time,
        (positions, velocities),
        load,
        np.hstack([load, np.zeros((len(time), 9))]),
        signals={"cables.tensions": np.abs(4 * np.sin(3 * turns))},
    )


def begun(call: list[Any], folder: Path, environment: dict | None = None) -> subprocess.Popen:
    """A Python program in a session of its own, once it has printed "begins"."""
    process = subprocess.Popen(
        [sys.executable, *call],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_handle_signals_as_a_shell_does,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begins\n"
    return process


def _handle_signals_as_a_shell_does() -> None:
    """A parent such as nohup may ignore signals, which children inherit."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


class Ports(LeafSystem):
    """A block that has ports of the given sizes and computes nothing; None: abstract ones."""

    def __init__(self, inputs, outputs):
        super().__init__()
        for name, size in inputs.items():
            if size is None:
                self.DeclareAbstractInputPort(name, Value(""))
            else:
                self.DeclareVectorInputPort(name, size)
        for name, size in outputs.items():
            if size is None:
                self.DeclareAbstractOutputPort(name, lambda: Value(""), lambda c, o: None)
            else:
                self.DeclareVectorOutputPort(name, size, lambda c, o: None, {self.time_ticket()})


def with_ports(inputs, outputs):
    """What makes such a block of a model."""
    return lambda model: Ports(inputs, outputs)
