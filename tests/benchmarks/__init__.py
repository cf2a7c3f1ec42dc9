"""Measurements of speed and quality, of the claims of the pages, and their pictures."""
