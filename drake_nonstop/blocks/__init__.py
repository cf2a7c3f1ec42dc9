"""The boxes of the figure, one file each, and what they can be swapped for."""
