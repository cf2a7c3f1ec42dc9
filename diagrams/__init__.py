"""Compositions of blocks; no equations."""
