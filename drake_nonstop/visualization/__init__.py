"""What a run looks like: the Meshcat scene, live and recorded, figures, and the diagram drawn."""
