"""One run: its steps, its signals and its metrics; no files, no pictures."""
