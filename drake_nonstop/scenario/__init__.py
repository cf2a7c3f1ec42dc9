"""What a run is: dataclasses and their YAML, overrides, users' own blocks; no simulation."""
