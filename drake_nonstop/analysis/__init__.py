"""Whether a task can be flown: speeds, stability, distances and margins of aircraft; no flights."""
