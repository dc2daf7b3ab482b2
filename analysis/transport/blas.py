"""Matrix products on one thread.

Two threads on products as small as a bounce's mostly wait for one another, and waiting costs
processor time: measured 0.07 s for the canonical tank on one, 0.2 s and more on two.
"""

from __future__ import annotations

from threadpoolctl import ThreadpoolController

BLAS = ThreadpoolController().select(user_api="blas")
