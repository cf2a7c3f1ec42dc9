import numpy as np
from helpers import INERTIA, Motion, rotation

from drake_nonstop.mechanics.load_motion import LoadMotion, torque_and_force
from drake_nonstop.mechanics.rigid_load import RigidLoad, load_acceleration
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.mechanics.taylor import Taylor

LOAD = RigidLoad(mass=1.3, inertia=INERTIA, drag=0.7, gravity=9.7, angular_drag=0.2)


def test_the_wrench_of_a_motion_moves_the_load_so(rng):
    load, wind, wrench = LOAD, rng.normal(size=3), rng.normal(size=6)
    quaternion, position, spin, velocity = LoadState.view(Motion(3).state(0.4))
    state = np.concatenate([quaternion, position, 3 * spin, velocity])
    angular, translational = load_acceleration(load, state, wrench, wind)
    in_time = Taylor.of_rates(position, velocity, translational), Taylor([3 * spin, angular])
    torque, force = torque_and_force(load, LoadMotion.of(quaternion, *in_time), wind)
    made = [rotation(quaternion) @ torque.rates[0], force.rates[0]]
    np.testing.assert_allclose(np.concatenate(made), wrench, atol=1e-12)
