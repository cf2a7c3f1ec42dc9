"""What makes blocks a loop: boxes, equilibrium, parameters, the trace and the compiled engine."""
