"""Limits, plans over a horizon, and layers as nonlinear programs; no ports and no contexts."""
