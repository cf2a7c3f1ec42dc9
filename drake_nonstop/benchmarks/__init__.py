"""Measurements of speed and of the quality of answers."""
