"""Drake systems from equations: tracing, blocks, wiring by name; no loads, no carriers."""
