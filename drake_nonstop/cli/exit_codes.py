"""What the command's exit codes mean."""

FAILED = 1
BAD_INPUT = 2
NOT_OK = 3  # a run came to its end with an outcome other than ok
INTERRUPTED = 130  # the shell's for Ctrl-C
