"""Measurements of speed and quality, and of the README's claims; no other room needs them."""
