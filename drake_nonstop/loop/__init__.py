"""Blocks made a loop: boxes, hold, equilibrium, parameters, trace and compiled engine."""
