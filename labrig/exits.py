"""Exit codes, one for each kind of trouble."""

EXIT_BAD_INPUT = 2
EXIT_DAMAGED = 3
EXIT_DEVICE = 4
EXIT_INTERRUPTED = 130
