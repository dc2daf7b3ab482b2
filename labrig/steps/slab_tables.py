"""Tables of a slab's orders kept on disk, so that a further fit of a like sample solves nothing."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from analysis.medium import Slab
from analysis.slab_fit import SlabFit, fit_slab
from analysis.slab_profiles import SlabProfiles
from analysis.slab_search import Contrasts
from analysis.slab_table import VERSION, Range, SlabTable
from analysis.transport.slab_resolution import depths
from labrig.folders import cache_folder

WIDE, ROOM_G = 1.35, 0.15  # of a table about a medium: factor in sigma_t, to each side of g
G_LIMITS = (-0.5, 0.95)
NODES = (5, 6)
FINENESS, FINER = 1.0, 0.4  # at g = 0, and how much more where g is one
BEYOND = 4.0  # heights that are solved for behind the last depth
DIGITS = 3  # of a wave number: what it is measured to changes the light by less than 1e-4
CHECKS, SEED = 3, 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """A fit by a kept table, and the table's own error."""

    fit: SlabFit
    error: float


def fit_by_kept(profiles: SlabProfiles, slab: Slab, contrasts: Contrasts | None) -> Looked | None:
    """Fit by a table that was kept for this slab and these stripes; None where none holds it."""
    q = profiles.stacked()[0]
    for path in sorted(cache_folder().glob(f"slab-{_digest(slab, q)}-*.npz")):
        table = SlabTable.load(path)
        if table is None or profiles.depth_mm.max() > table.x_mm[-1]:
            continue
        table = replace(table, wavenumbers_per_mm=q)
        found = fit_slab(profiles, slab, table=table, contrasts=contrasts, unknown_walls=True)
        if not found.at_limit:
            return Looked(fit=found, error=table.error)
    return None


def keep_table(profiles: SlabProfiles, slab: Slab, fit: SlabFit) -> SlabTable:
    """Make and keep a table around the medium that a fit found, and return it with its error."""
    q, g = profiles.stacked()[0], fit.g
    end = profiles.depth_mm.max() + profiles.bin_mm + BEYOND * slab.height_mm
    solved = replace(slab, depth_mm=min(slab.depth_mm, float(end)))
    of_t: Range = (fit.sigma_t_per_mm / WIDE, fit.sigma_t_per_mm * WIDE)
    of_g: Range = (max(G_LIMITS[0], g - ROOM_G), min(G_LIMITS[1], g + ROOM_G))
    fineness = FINENESS + FINER * g**8
    table = SlabTable.build(
        solved,
        q,
        depths(fit.sigma_t_per_mm, solved, fineness=fineness),
        sigma_t_per_mm=of_t,
        g=of_g,
        n_nodes=NODES,
        fineness=fineness,
    ).checked(n=CHECKS, seed=SEED)
    table.save(_place(slab, q, of_t, of_g))
    return table


def _place(slab: Slab, q: np.ndarray, of_t: Range, of_g: Range) -> Path:
    told = hashlib.sha256(json.dumps([of_t, of_g]).encode()).hexdigest()[:12]
    return cache_folder() / f"slab-{_digest(slab, q)}-{told}.npz"


def _digest(slab: Slab, q: np.ndarray) -> str:
    """Return the name of what a table is about, but for its ranges."""
    rounded = [float(f"{value:.{DIGITS}g}") for value in q]
    question = [VERSION, slab.height_mm, slab.surface_index, rounded]
    return hashlib.sha256(json.dumps(question).encode()).hexdigest()[:16]
