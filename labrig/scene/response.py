"""The tank's answer to stripes and to white light, by Monte Carlo, kept on disk.

Light is linear, and stripes of one period are a sum of a few harmonics: one run of the Monte
Carlo serves every shift, every exposure and every repeat of a plan.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from analysis.errors import AnalysisError
from analysis.phase_function import power_removed
from analysis.transport.montecarlo import SampledField, Walls, simulate
from labrig.models.scene import Scene
from labrig.scene.answer import Answer
from labrig.scene.stripes import FIRST

VERSION = 1  # of the kept files; raise it when the Monte Carlo changes its answer
HIGHER_SHARE = 8  # harmonics beyond the first two are followed by n_paths over this


@dataclass(frozen=True, slots=True, kw_only=True)
class TankResponse:
    """Scattered light of a scene: per bounce under white light, and per harmonic of the stripes."""

    field: SampledField
    n_bounces: int
    from_cache: bool


def bounces_needed(albedo: float, tail: float) -> int:
    """Return K with albedo^K below ``tail``: later bounces hold less than that share of light."""
    if albedo <= 0.0:
        return 2
    if albedo >= 1.0:
        return 400
    return min(400, max(2, math.ceil(math.log(tail) / math.log(albedo))))


def bounces_of(scene: Scene) -> int:
    """Return the last bounce of a scene that is followed.

    Raises
    ------
    AnalysisError
        If no number of bounces would be enough.
    """
    medium = scene.medium.record()
    # With hg-paper a bounce keeps the share albedo * N3(g), which is not below one for every g.
    kept_share = medium.albedo * power_removed(medium.g, medium.phase)
    if kept_share > 1.0:
        msg = (
            f"{medium.phase} at g = {medium.g}, albedo {medium.albedo:.4g}: a bounce multiplies "
            f"the light by {kept_share:.4g}, and no number of them is enough; choose hg-plane."
        )
        raise AnalysisError(msg)
    return bounces_needed(kept_share, scene.transport.tail)


def answer_by_montecarlo(
    scene: Scene,
    harmonics: Mapping[float, tuple[int, ...]],
    walls: Walls | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    anew: bool = False,
) -> Answer:
    """Return a tank's answer to stripes of some periods (mm), each with its first harmonics.

    A plan without stripes is answered with those of a period as wide as the tank.
    """
    waves = {}
    white, from_cache = None, True
    for period_mm, wanted in (harmonics or {scene.tank.width_mm: FIRST}).items():
        for some in (FIRST, tuple(h for h in wanted if h not in FIRST)):
            if not some:
                continue
            found = tank_response(
                scene,
                period_mm=period_mm,
                harmonics=some,
                walls=walls,
                progress=progress,
                anew=anew,
            )
            white = white or found
            from_cache = from_cache and found.from_cache
            for harmonic, wave in zip(some, found.field.modulated, strict=True):
                waves[period_mm, harmonic] = wave
    if white is None:
        msg = "every period has its first harmonics"
        raise AssertionError(msg)
    field = white.field
    return Answer(
        x_mm=field.x_mm,
        y_mm=field.y_mm,
        fluence=field.fluence,
        waves=waves,
        method="montecarlo",
        from_cache=from_cache,
    )


def tank_response(
    scene: Scene,
    *,
    period_mm: float,
    harmonics: tuple[int, ...] = FIRST,
    walls: Walls | None = None,
    progress: Callable[[int, int], None] | None = None,
    anew: bool = False,
) -> TankResponse:
    """Return the response of a scene's tank to stripes of a period along y.

    Computed once for a medium, tank, beam and period, then read from the cache folder. Harmonics
    beyond the usual ones hold so little light that a share of the paths serves them.
    """
    medium = scene.medium.record()
    n_bounces = bounces_of(scene)
    question: dict[str, object] = {
        "version": VERSION,
        "medium": scene.medium.model_dump(),
        "tank": scene.tank.model_dump(),
        "beam": scene.beam.model_dump(),
        "transport": scene.transport.model_dump(),
        "period_mm": period_mm,
        "harmonics": harmonics,
    }
    if walls is not None:
        question["walls"] = asdict(walls)
    key = hashlib.sha256(json.dumps(question, sort_keys=True).encode()).hexdigest()[:24]
    kept = cache_folder() / f"response-{key}.npz"
    if kept.is_file() and not anew:
        found = _read(kept)
        if found is not None:
            return TankResponse(field=found, n_bounces=n_bounces, from_cache=True)
    n_paths = scene.transport.n_paths
    if harmonics != FIRST:
        n_paths = max(n_paths // HIGHER_SHARE, 1000)
    sampled = simulate(
        medium,
        scene.tank.record(),
        scene.beam.record(),
        n_bounces=n_bounces,
        n_paths=n_paths,
        cell_mm=scene.transport.cell_mm,
        seed=scene.transport.seed,
        stripe_wavenumber_per_mm=2.0 * math.pi / period_mm,
        harmonics=harmonics,
        walls=walls,
        n_threads=os.cpu_count() or 1,
        progress=progress,
    )
    _write(kept, sampled)
    return TankResponse(field=sampled, n_bounces=n_bounces, from_cache=False)


def cache_folder() -> Path:
    """Return where computed responses are kept; everything in it can be deleted."""
    root = os.environ.get("LABRIG_CACHE") or os.environ.get("XDG_CACHE_HOME")
    base = Path(root) if root else Path.home() / ".cache"
    return base / "labrig"


def _read(path: Path) -> SampledField | None:
    """Return what was kept, None if the file is damaged: it is only a cache."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            return SampledField(**{f.name: kept[f.name][()] for f in fields(SampledField)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _write(path: Path, sampled: SampledField) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
        np.savez(part, **{f.name: getattr(sampled, f.name) for f in fields(SampledField)})
    Path(part.name).replace(path)
