"""The level of Drake's log."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def drake_log_level(level: int) -> Iterator[None]:
    """Within it Drake logs nothing below the `level` of Python's logging."""
    logger = logging.getLogger("drake")
    previous = logger.level
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(previous)
