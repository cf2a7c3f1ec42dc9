"""Measurements of the speed of a scenario and of both engines; no other room needs them."""
