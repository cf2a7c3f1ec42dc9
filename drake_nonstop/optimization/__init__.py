"""The nonstop problem of one update, its search and its solvers; no ports and no contexts."""
