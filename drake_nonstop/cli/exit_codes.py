"""What the command's exit codes mean."""

FAILED = 1
BAD_INPUT = 2
INTERRUPTED = 130  # the shell's for Ctrl-C
