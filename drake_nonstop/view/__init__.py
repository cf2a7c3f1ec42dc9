"""Pictures of runs: the Meshcat scene, live and recorded, figures, and the diagram drawn."""
