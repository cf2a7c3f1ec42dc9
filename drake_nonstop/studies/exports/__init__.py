"""A run in the files of other tools."""
