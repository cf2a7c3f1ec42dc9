"""What makes an equation a Drake system: tracing, blocks, wiring by name; no loads, no carriers."""
