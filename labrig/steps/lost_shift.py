"""One shift that was lost, out of the others.

A shift by half a period lights what the other left dark, so that the two pictures of such a pair
add up to the same light whatever the shift: ``I_k + I_(k + n/2) = I_j + I_(j + n/2)``. That needs
stripes half of whose period is lit, and light that did not change meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.hdr import Radiance
from labrig.errors import AnalysisRefusedError
from labrig.session import Session

HALF = 0.5


def lost_pictures(session: Session, pictures: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return the pictures that lack a shot; ``pictures`` names the shots of each."""
    missing = set(session.missing)
    return tuple(name for name, shots in pictures.items() if missing & set(shots))


def refuse_unless_replaceable(
    session: Session, lost: Sequence[str], series: Sequence[tuple[Sequence[str], float]]
) -> None:
    """Refuse a session that lacks more than one shift of each of its series.

    Parameters
    ----------
    series : names of the shifts' pictures, and the lit share of the period, of each

    Raises
    ------
    AnalysisRefusedError
        If another picture is lost, two of a series, or there is no pair to learn from.
    """
    whole = {
        name
        for names, duty in series
        if duty == HALF
        and len(names) % 2 == 0
        and len(names) > 2
        and len(set(names) & set(lost)) == 1
        for name in names
    }
    if not set(lost) <= whole:
        msg = (
            f"session {session.path.name}: {len(session.missing)} of {len(session.shots)} shots "
            f"are missing ({session.missing[0]} first); capture it anew."
        )
        raise AnalysisRefusedError(msg)


def from_the_others(names: Sequence[str], lost: str, known: Mapping[str, Radiance]) -> Radiance:
    """Return the picture of a lost shift, with its variance: the pairs' mean less its opposite."""
    half, k = len(names) // 2, names.index(lost)
    opposite = known[names[(k + half) % len(names)]]
    pairs = [(known[names[j]], known[names[j + half]]) for j in range(half) if j != k % half]
    n = len(pairs)
    value = sum((a.value + b.value for a, b in pairs), -n * opposite.value) / n
    of_pairs = sum((a.variance + b.variance for a, b in pairs), np.float32(0.0)) / n**2
    return Radiance(
        value=np.asarray(value, dtype=np.float32),
        variance=np.asarray(of_pairs + opposite.variance, dtype=np.float32),
        valid=np.isfinite(value),
    )
