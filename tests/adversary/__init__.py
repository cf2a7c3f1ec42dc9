"""Bad and extreme inputs, drawn by Hypothesis: one sentence for each, and nothing is lost.

`make adversary COUNT=2000 SEED=1` tries more and others; a failure prints the smallest input.
"""
