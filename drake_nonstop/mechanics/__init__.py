"""The equations of the method, each written once.

Every function is plain NumPy on arrays, without state, in-place writes or branches
on values, so that the same text runs on floats, on pydrake's `AutoDiffXd` and
`Expression`, and on CasADi's `SX` (see `drake_nonstop.systems.tracing`).

Frames are W (world, z up) and L (load, at its centre of mass); `R_WL` turns load
coordinates into world coordinates. All quantities are SI. "eq. k" is the k-th
numbered equation of the paper, counted from the carrier position (eq. 1).
"""
