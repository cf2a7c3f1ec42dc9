"""Cables of nodes as a block: their start, and the drag that aircraft no longer have of them."""

import numpy as np
from helpers import fix, model, output

from drake_nonstop.blocks.cables import Cables, LumpedCables


def test_trimmed_cables_pull_as_straight_ones_at_both_ends():
    made, load = model(4), np.array([1.0, *np.zeros(12)])
    above = made.attachments + np.array([0.1, 0.0, 0.82])
    carriers = np.concatenate([above.ravel(), np.full(12, 0.1)])
    found = []
    for block in (Cables(made), LumpedCables(made)):
        context = block.CreateDefaultContext()
        fix(block, context, load_state=load, carrier_state=carriers)
        if isinstance(block, LumpedCables):
            fix(block, context, wind=np.zeros(12), load_wind=np.zeros(3))
            block.trim(context)
            shares = np.array([0.5, 11.5])[:, None, None] / 12
            state = output(block, context, "cable_state").reshape(2, 12, 4, 3)
            expected = made.attachments + shares * (above - made.attachments)
            np.testing.assert_allclose(state[0, [0, -1]], expected, atol=1e-12)
            np.testing.assert_allclose(state[1, [0, -1]], np.ones((4, 3)) * 0.1 * shares)
        found.append([output(block, context, f"{end}cable_forces") for end in ("", "carrier_")])
    np.testing.assert_allclose(found[0], found[1], atol=0.02)  # but for what dampers add
