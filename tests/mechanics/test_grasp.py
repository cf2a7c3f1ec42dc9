import numpy as np
from helpers import Motion, difference, over_shapes, rotation

from drake_nonstop.mechanics.grasp import cable_forces_and_rates, grasp_matrix
from drake_nonstop.mechanics.internal_force import hamiltonian_cycle


def paper_grasp_matrix(attachments, R_WL):
    """Eq. 8: [force; torque] of world forces, at an orientation R of the load."""
    n = len(attachments)
    G = np.zeros((6, 3 * n))
    for i, lever in enumerate(attachments @ R_WL.T):
        x, y, z = lever
        G[:3, 3 * i : 3 * i + 3] = np.eye(3)
        G[3:, 3 * i : 3 * i + 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    return G


@over_shapes
def test_forces_and_their_rates_are_the_papers_in_the_world_frame(attachments, rng):
    """Of a wrench and internal forces that change in time over a load that turns."""
    n, motion, time = len(attachments), Motion(4), 0.9
    basis = hamiltonian_cycle(attachments)
    offset = basis @ rng.normal(size=n)
    sizes, starts = rng.uniform(0.5, 2, (2, 6 + n))
    inverse = np.linalg.pinv(grasp_matrix(attachments))

    def pull(t, order=0):
        """[torque; force], and λ."""
        return np.split(sizes * np.sin(t + starts + order * np.pi / 2), [6])

    def expected(t):
        R, (wrench, internal) = rotation(motion.state(t)[:4]), pull(t)
        minimal = np.linalg.pinv(paper_grasp_matrix(attachments, R)) @ np.roll(wrench, 3)
        return minimal + np.kron(np.eye(n), R) @ (offset + basis @ internal)

    (wrench, internal), (wrench_rate, internal_rate) = pull(time), pull(time, 1)
    forces, rates = cable_forces_and_rates(
        *(motion.state(time), wrench, wrench_rate, np.append(internal, internal_rate)),
        pseudo_inverse=inverse,
        basis=basis,
        offset=offset,
    )
    np.testing.assert_allclose(forces.ravel(), expected(time), rtol=0, atol=1e-12)
    np.testing.assert_allclose(rates.ravel(), difference(expected, time), rtol=0, atol=1e-10)
