"""What several blocks believe of load, cables and carriers, patterns, and their files."""
