"""Descriptions of runs: dataclasses and their YAML, overrides, users' own blocks; no simulation."""
