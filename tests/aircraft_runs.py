"""Made-up runs, such as that of aircraft that hold a resting load, for several test files."""

import numpy as np

from drake_nonstop import AircraftParameters, Run, Scenario, SystemParameters
from drake_nonstop.mechanics.aircraft import flight_needs, needed_force
from drake_nonstop.model.system import aircraft_in

LOAD_MASS, ATTACHMENTS_RADIUS, CABLE_LENGTH = 10.0, 1.5, 150.0  # kg, m, m
FREQUENCY = 0.595  # rad/s
SPREAD, RADIAL, TANGENTIAL, VERTICAL = 6.75, 3.3, 4.5, 4.9  # N
PERIOD = 0.01  # s


def attachments():
    angles = np.pi / 2 * np.arange(4)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(4)])
    return ATTACHMENTS_RADIUS * ring


def orbits(time):
    """Positions and cables' forces (k, 4, 3) of taut cables of constant length, in m and N."""
    radial = attachments() / ATTACHMENTS_RADIUS
    tangential = np.cross([0.0, 0.0, 1.0], radial)
    phase = (FREQUENCY * time[:, None] - np.pi * np.arange(4))[..., None]
    forces = (SPREAD + RADIAL * np.cos(phase)) * radial + TANGENTIAL * np.sin(phase) * tangential
    share = LOAD_MASS * 9.81 / 4
    forces = forces + (share - VERTICAL * np.cos(phase)) * np.array([0.0, 0.0, 1.0])
    lengths = np.linalg.norm(forces, axis=2, keepdims=True)
    return attachments() + CABLE_LENGTH * forces / lengths, forces


def made_up(scenario, time, motion, load, reference, *, signals=None, steps=None, **fields):
    """A run whose carriers have positions and velocities (k, n, 3) at each time and step."""
    carriers = np.hstack([part.reshape(len(time), -1) for part in motion])
    own = {
        "load_plant.load_state": load,
        "load_trajectory.reference": reference,
        "carrier_dynamics.carrier_state": carriers,
    }
    flown = {"time": time, "load_state": load, "carrier_state": carriers}
    return Run(
        scenario=scenario,
        diagram=None,
        time=time,
        signals=own | (signals or {}),
        steps=flown | (steps or {}),
        **{"solve_times": np.zeros(0), "wall_time": 1.0} | fields,
    )


def aircraft_run(duration=11.0, wind=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)):
    """Four aircraft of 6 kg on 150 m cables, in a steady wind, above a load that moves steadily."""
    time = np.arange(0, duration + 1e-9, PERIOD)
    step = 1e-3  # s
    before, now, after = (orbits(time + shift)[0] for shift in (-step, 0.0, step))
    moved = np.multiply.outer(time, velocity)
    positions = now + moved[:, None]
    velocities = (after - before) / (2 * step) + np.array(velocity)
    accelerations = (after - 2 * now + before) / step**2
    forces = orbits(time)[1]
    system = SystemParameters(
        load_mass=LOAD_MASS,
        attachments=attachments().tolist(),
        cable_length=CABLE_LENGTH,
        aircraft=AircraftParameters(model="rascal_110"),
    )
    aircraft = aircraft_in(system)
    winds = np.broadcast_to(np.array(wind), positions.shape)
    needed = needed_force(aircraft, accelerations, forces)
    told = flight_needs(aircraft, needed, velocities - winds).command
    airspeeds = np.linalg.norm(velocities - winds, axis=2)
    state = np.hstack([*told, airspeeds])
    load = np.zeros((len(time), 13))
    load[:, 0] = 1.0
    load[:, 4:7], load[:, 10:13] = moved, velocity
    reference = np.hstack([load, np.zeros((len(time), 9))])
    tensions = np.linalg.norm(forces, axis=2)
    return made_up(
        Scenario(name="aircraft", system=system, simulation_duration=duration),
        time,
        (positions, velocities),
        load,
        reference,
        signals={
            "carrier_dynamics.aircraft_state": state,
            "cables.tensions": tensions,
            "optimization_layer.parameters": np.tile([FREQUENCY, RADIAL], (len(time), 1)),
            "wind.wind": np.tile(wind, (len(time), 4)),
            "wind.load_wind": np.tile(wind, (len(time), 1)),
        },
        steps={
            "aircraft_state": state,
            "command_saturation": np.zeros((len(time), 12)),
            "tensions": tensions,
        },
    )
