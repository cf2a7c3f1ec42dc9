"""Models of load, cables and carriers that blocks share, patterns, and their files."""
