"""One run: its equilibrium, its steps, its signals and its metrics; no files, no pictures."""
