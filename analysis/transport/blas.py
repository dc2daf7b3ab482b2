"""Matrix products on one thread.

Two threads on products as small as a bounce's mostly wait for one another, and waiting costs
processor time: measured 0.07 s for the canonical tank on one, 0.2 s and more on two.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from threadpoolctl import ThreadpoolController

BLAS = ThreadpoolController().select(user_api="blas")


class _Users:
    """Who wants one thread now: the first asks the library for it, the last gives it back."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.number = 0
        self.limit: Any = None


_users = _Users()


@contextmanager
def on_one_thread() -> Iterator[None]:
    """Keep matrix products to one thread meanwhile; within another such block it costs nothing."""
    with _users.lock:
        if _users.number == 0:
            _users.limit = BLAS.limit(limits=1)
        _users.number += 1
    try:
        yield
    finally:
        with _users.lock:
            _users.number -= 1
            if _users.number == 0:
                _users.limit.restore_original_limits()
