"""Drawn plausible scenarios: names and overrides."""

import numpy as np

from drake_nonstop.scenario.loading import scenario_names


def draw(seed: int) -> tuple[str, list[str]]:
    """A scenario's name and the overrides that make it another one."""
    rng = np.random.default_rng([16, seed])

    def uniform(low, high):
        return round(float(rng.uniform(low, high)), 4)

    def log_uniform(low, high):
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")

    def choice(*values):
        return values[int(rng.integers(len(values)))]

    def chance(share):
        return rng.random() < share

    is_large = chance(0.15)
    n = int(rng.integers(3, 9))
    duration = uniform(4.0, 5.0)
    angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.15, 0.15, n)) / n
    radius = 1.5 if is_large else uniform(0.4, 1.0)
    heights = rng.uniform(-0.1, 0.1, n) * radius * chance(0.3)
    attachments = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])
    load_mass = uniform(5.0, 15.0) if is_large else uniform(0.5, 2.0)
    share = load_mass * 9.81 / n
    pattern = choice("HamiltonianCycle", "HamiltonianCycle", "Carousel", "SpreadCarousel")
    settings = {
        "simulation_duration": duration,
        "system.attachments": np.round(attachments, 4).tolist(),
        "system.load_mass": load_mass,
        "load_trajectory": _trajectory(duration, is_large, uniform, choice, chance),
    }
    amplitude = round(share * uniform(0.3, 0.9), 4)
    if pattern == "SpreadCarousel":
        settings["pattern"] = f"!SpreadCarousel {{spread: {round(amplitude * 1.5, 4)}}}"
    else:
        settings["pattern"] = f"!{pattern} {{}}"
    frequency = uniform(0.25, 0.7) if is_large else uniform(1.0, 4.0)
    length = 60.0 if is_large else uniform(0.5, 1.5)
    speed = frequency * length * amplitude / np.hypot(amplitude, share)
    control_period = choice(0.005, 0.01, 0.01, 0.01, 0.02, 0.05, 0.1)
    layer = {
        "frequency": frequency,
        "amplitude": amplitude,
        "speed_bound": round(float(speed) * uniform(0.3, 0.9), 4),
    }
    if chance(0.35):
        name = "ConstantParameters"
    else:
        name = ("NlpLayer", "PaperLayer")[seed % 2]
        layer["period"] = round(control_period * choice(1, 1, 1, 2, 5), 4)
        if is_large:
            layer["frequency_bounds"] = [0.1, 2.0]
    settings["optimization_layer"] = _tagged(name, layer)
    settings["control_period"] = control_period
    settings["simulator_config.max_step_size"] = choice(0.0025, 0.005, 0.005, 0.005, 0.01)
    if is_large:
        settings["carrier_controller.frequency"] = uniform(8.0, 30.0)
        settings["carrier_controller.damping"] = uniform(0.3, 1.0)
    else:
        # Carriers that are faster than the load swings on its cables, as any that work.
        carrier_mass, rate, damping = log_uniform(0.05, 0.4), uniform(50, 130), uniform(0.3, 1.0)
        swing = rate * uniform(0.15, 0.5)
        settings["system.cable_length"] = length
        settings["system.cable_stiffness"] = float(f"{load_mass / n * swing**2:.4g}")
        settings["system.cable_damping"] = (
            log_uniform(1e4, 1e7) if chance(0.05) else log_uniform(0.01, 5.0)
        )
        settings["system.carrier_mass"] = carrier_mass
        exact = {
            "position_gain": carrier_mass * rate**2,
            "velocity_gain": 2 * damping * carrier_mass * rate,
        }
        gains = {
            "position_gain": float(f"{carrier_mass * rate**2:.4g}"),
            "velocity_gain": float(f"{2 * damping * carrier_mass * rate:.4g}"),
        }
        settings["carrier_controller"] = choice(
            _tagged("CarrierPid", exact),
            _tagged("CarrierPid", gains),
            _tagged("FeedforwardCarrierPid", gains),
        )
    further = {
        "load_feedback": _tagged(
            "NoisyFeedback", {"position_noise": uniform(0, 0.003), "period": control_period}
        ),
        "load_disturbance": _tagged(
            "DisturbanceForce",
            {"force": [uniform(-1, 1), uniform(-1, 1), 0.0], "gust_force": uniform(0, 0.5)},
        ),
        "simulated.load_mass": round(load_mass * uniform(0.9, 1.1), 4),
        "phase": "!PaperPhase {}",
        "load_plant": "!MultibodyLoadPlant {}",
        "engine": "compiled",
        "wrench_controller": "!TunedWrenchController {}",
        "simulator_config.integration_scheme": choice(
            "runge_kutta2", "bogacki_shampine3", "explicit_euler", "implicit_euler", "radau3"
        ),
        "simulator_config.use_error_control": "true",
        "simulated.cable_damping": 0.0,
    }
    for path, value in further.items():
        if chance({"engine": 0.25}.get(path, 0.06)):
            settings[path] = value
    if settings.get("system.cable_damping", 0.0) > 1e3:  # what no explicit scheme can fly
        settings.pop("simulator_config.integration_scheme", None)
        settings.pop("simulator_config.use_error_control", None)
    return (
        "real_scale_spread" if is_large else "quintic",
        [f"{path}={value}" for path, value in settings.items()],
    )


def draw_aircraft(seed: int) -> tuple[str, list[str]]:
    """A shipped scenario of aircraft, in a wind, with disturbances and errors of the model."""
    rng = np.random.default_rng([18, seed])
    shipped = [name for name in scenario_names() if "_cables" not in name]
    name = str(rng.choice([name for name in shipped if name.startswith("aircraft_")]))
    velocity = [*rng.uniform(-3, 3, 2).round(3).tolist(), 0.0]
    wind, law = (
        ("StillAir", {}),
        ("SteadyWind", {"velocity": velocity, "rise_time": round(rng.uniform(0, 5), 3)}),
        ("GustyWind", {"velocity": velocity, "gust": round(rng.uniform(0, 1), 3), "seed": seed}),
    )[rng.integers(3)]
    settings = {"simulation_duration": 10.0, "wind": _tagged(wind, law)}
    settings["simulator_config.max_step_size"] = float(rng.choice([0.01, 0.02, 0.04]))
    settings["control_period"] = float(rng.choice([0.0, 0.01, 0.04, 0.1]))
    force = [*rng.uniform(-5, 5, 2).round(3).tolist(), 0.0]
    further = {
        "load_disturbance": _tagged("DisturbanceForce", {"force": force, "gust_force": 2.0}),
        "simulated.load_mass": round(10 * rng.uniform(0.9, 1.1), 4),
        "simulated.aircraft.lift_gain": round(rng.uniform(0.9, 1.05), 4),
        "simulated.aircraft.thrust_gain": round(rng.uniform(0.8, 1.1), 4),
    }
    settings |= {path: value for path, value in further.items() if rng.random() < 0.3}
    return name, [f"{path}={value}" for path, value in settings.items()]


def _trajectory(duration, is_large, uniform, choice, chance):
    start = uniform(0.3, 1.0)
    move = round(min(uniform(1.5, 6.0), duration - start), 4)
    size = 5.0 if is_large else uniform(0.1, 1.5)
    shift = [round(size * uniform(-1, 1), 4) for _ in range(3)]
    angles = [uniform(-0.2, 0.2), uniform(-0.2, 0.2), 0.0]
    if chance(0.4):
        angles[2] = choice(uniform(-1.5, 1.5), 3.1416, 6.2832)
    kind = choice("RestToRest", "RestToRest", "ConstantVelocityMove", "Waypoints")
    if kind == "ConstantVelocityMove":
        blend = round(min(choice(0.2, 0.5, 1.0), 2 * start, move), 4)
        velocity = [round(s / move, 4) for s in shift]
        values = {"velocity": velocity, "start_time": start, "move_time": move, "blend_time": blend}
    elif kind == "Waypoints":
        half = round(move / 2, 4)
        values = {"positions": [shift, [0, 0, 0]], "move_times": [half, half]}
    else:
        values = {
            "displacement": shift,
            "roll_pitch_yaw": angles,
            "start_time": start,
            "move_time": move,
        }
    return _tagged(kind, values)


def _tagged(name, values):
    return f"!{name} {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"
