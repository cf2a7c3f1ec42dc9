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


def paper_order(wrench):
    """[torque; force] as [force; torque]."""
    return np.concatenate([wrench[3:], wrench[:3]])


def random_arguments(attachments, rng):
    """Load state, wrench and its rate, [λ; λ̇], and the constants, at random."""
    n = len(attachments)
    basis = hamiltonian_cycle(attachments)
    return (
        [
            np.concatenate(
                [q / np.linalg.norm(q) for q in [rng.normal(size=4)]] + [rng.normal(size=9)]
            ),
            *rng.normal(size=(2, 6)),
            rng.normal(size=2 * n),
        ],
        {
            "pseudo_inverse": np.linalg.pinv(grasp_matrix(attachments)),
            "basis": basis,
            "offset": basis @ rng.normal(size=n),
        },
    )


@over_shapes
def test_forces_are_the_papers_in_the_world_frame(attachments, rng):
    (state, wrench, rate, internal), constants = random_arguments(attachments, rng)
    forces, _ = cable_forces_and_rates(state, wrench, rate, internal, **constants)
    n = len(attachments)
    R = rotation(state[:4])
    N = np.kron(np.eye(n), R) @ constants["basis"]
    expected = (
        np.linalg.pinv(paper_grasp_matrix(attachments, R)) @ paper_order(wrench)
        + np.kron(np.eye(n), R) @ constants["offset"]
        + N @ internal[:n]
    )
    np.testing.assert_allclose(forces.ravel(), expected, rtol=0, atol=1e-12)


class Pull:
    """A wrench and internal forces that change in time over a load that turns."""

    def __init__(self, attachments):
        rng = np.random.default_rng(3)
        self.attachments, self.n = attachments, len(attachments)
        self.motion = Motion(4)
        self.wrench_size, self.wrench_start = rng.uniform(0.5, 2, 6), rng.uniform(0, 6, 6)
        self.size, self.start = rng.uniform(0.5, 1.5, self.n), rng.uniform(0, 6, self.n)
        self.basis = hamiltonian_cycle(attachments)
        self.constants = {
            "pseudo_inverse": np.linalg.pinv(grasp_matrix(attachments)),
            "basis": self.basis,
            "offset": self.basis @ rng.normal(size=self.n),
        }

    def wrench(self, t, order=0):
        return self.wrench_size * np.sin(t + self.wrench_start + order * np.pi / 2)

    def internal(self, t, order=0):
        return self.size * 1.3**order * np.sin(1.3 * t + self.start + order * np.pi / 2)

    def rotation(self, t):
        return rotation(self.motion.state(t)[:4])

    def forces_and_rates(self, t):
        internal = np.concatenate([self.internal(t), self.internal(t, 1)])
        return cable_forces_and_rates(
            self.motion.state(t), self.wrench(t), self.wrench(t, 1), internal, **self.constants
        )


@over_shapes
def test_force_rates_are_the_papers_sum_of_four_terms(attachments, rng):
    pull = Pull(attachments)
    pull.constants["offset"] = np.zeros(3 * pull.n)  # which the paper has not

    def inverse(t):
        return np.linalg.pinv(paper_grasp_matrix(attachments, pull.rotation(t)))

    def basis(t):
        return np.kron(np.eye(pull.n), pull.rotation(t)) @ pull.basis

    time = 0.9
    expected = (
        difference(inverse, time) @ paper_order(pull.wrench(time))
        + inverse(time) @ paper_order(pull.wrench(time, 1))
        + difference(basis, time) @ pull.internal(time)
        + basis(time) @ pull.internal(time, 1)
    )
    rates = pull.forces_and_rates(time)[1]
    np.testing.assert_allclose(rates.ravel(), expected, rtol=0, atol=1e-10)
