"""What of a plan is still to be taken, block by block."""

from __future__ import annotations

from collections.abc import Iterable

from labrig.models.plan import Shot
from labrig.plan import blocks_of

Block = tuple[Shot, ...]


class Agenda:
    """The shots of a plan in blocks without a gap; which are taken, skipped or doubted.

    ``taken`` may still be on the way to the disk.
    """

    def __init__(self, shots: tuple[Shot, ...]) -> None:
        self.shots = shots
        self.blocks = tuple(blocks_of(shots))
        self.taken: set[str] = set()
        self.shortest_s = min(shot.exposure_s for shot in shots)
        self._skipped: set[str] = set()
        self._doubted: set[str] = set()
        self._last_s: dict[str, float] = {}

    def wants(self, shot: Shot) -> bool:
        """Whether a shot is still to be taken."""
        return shot.id not in self.taken and shot.id not in self._skipped

    def left(self) -> list[Shot]:
        """Return all shots that are still to be taken."""
        return [shot for shot in self.shots if self.wants(shot)]

    def next_block(self) -> Block | None:
        """Return the first block that lacks a shot; None if none does."""
        return next((b for b in self.blocks if any(self.wants(shot) for shot in b)), None)

    def take(self, shot: Shot, block: Block, now_s: float) -> None:
        """Count a shot as taken."""
        self.taken.add(shot.id)
        self._last_s[block[0].id] = now_s

    def lose(self, ids: Iterable[str]) -> None:
        """Let shots be taken again."""
        self.taken.difference_update(ids)

    def restart(self, block: Block) -> None:
        """Let a block be taken again from its start."""
        self.lose(shot.id for shot in block)
        self._last_s.pop(block[0].id, None)

    def skip(self, block: Block) -> None:
        """Leave out what a block lacks."""
        self._skipped |= {shot.id for shot in block if shot.id not in self.taken}

    def stood_still_s(self, block: Block, now_s: float) -> float:
        """Return for how long a block that was begun has waited for its next shot, s."""
        begun = any(shot.id in self.taken for shot in block)
        return now_s - self._last_s.get(block[0].id, now_s) if begun else 0.0

    def doubted(self, block: Block) -> bool:
        """Whether the pictures of a block have contradicted others before."""
        return block[0].id in self._doubted

    def doubt(self, block: Block, other: str) -> list[Block]:
        """Return a block, and that of another shot: one of them is wrong, and both are taken again.

        The first alone is remembered as doubted; if it is again, the operator is asked.
        """
        self._doubted.add(block[0].id)
        return [b for b in self.blocks if b == block or any(shot.id == other for shot in b)]
