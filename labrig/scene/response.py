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
import time
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from analysis.errors import AnalysisError
from analysis.phase_function import power_removed
from analysis.transport.montecarlo import SampledField, Walls, simulate
from labrig.folders import cache_folder
from labrig.models.scene import Scene
from labrig.scene.answer import Answer
from labrig.scene.layer import sample_layer
from labrig.scene.stripes import FIRST

VERSION = 1  # of the kept files; raise it when the Monte Carlo changes its answer
NO_LIGHT = {"height_std_mm", "index_std"}  # of a tank: what changes nothing of its light
HIGHER_SHARE = 8  # harmonics beyond the first two are followed by n_paths over this


@dataclass(frozen=True, slots=True, kw_only=True)
class TankResponse:
    """Scattered light of a scene: per bounce under white light, and per harmonic of the stripes.

    ``seconds`` are of the CPU, for computing it, be it now or when it was kept.
    """

    field: SampledField
    seconds: float
    from_cache: bool

    @property
    def n_bounces(self) -> int:
        """Number of the last bounce."""
        return int(self.field.fluence.shape[0]) + 1


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
    return bounces_needed(kept_share, scene.tail)


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
    found: list[tuple[float, tuple[int, ...], TankResponse]] = []
    for period_mm, wanted in (harmonics or {scene.tank.width_mm: FIRST}).items():
        for some in (FIRST, tuple(h for h in wanted if h not in FIRST)):
            if some:
                response = tank_response(
                    scene,
                    period_mm=period_mm,
                    harmonics=some,
                    walls=walls,
                    progress=progress,
                    anew=anew,
                )
                found.append((period_mm, some, response))
    white = found[0][2].field
    return Answer(
        x_mm=white.x_mm,
        y_mm=white.y_mm,
        fluence=white.fluence,
        std_error=white.std_error,
        waves={
            (period_mm, harmonic): wave
            for period_mm, some, response in found
            for harmonic, wave in zip(some, response.field.modulated, strict=True)
        },
        method="montecarlo",
        seconds=sum(response.seconds for _, _, response in found),
        from_cache=all(response.from_cache for _, _, response in found),
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
    n_bounces = bounces_of(scene)
    kept = cache_folder() / f"response-{_key(scene, period_mm, harmonics, walls)}.npz"
    if kept.is_file() and not anew:
        found = _read(kept)
        if found is not None:
            return found
    n_paths = scene.transport.n_paths
    if harmonics != FIRST:
        n_paths = max(n_paths // HIGHER_SHARE, 1000)
    begun_s = time.process_time()
    slab, wavenumber = scene.tank.slab(), 2.0 * math.pi / period_mm
    if slab is not None:
        sampled = sample_layer(
            scene, slab, n_bounces, n_paths, (wavenumber, harmonics), progress=progress
        )
    else:
        sampled = simulate(
            scene.medium.record(),
            scene.tank.record(),
            scene.beam.record(),
            n_bounces=n_bounces,
            n_paths=n_paths,
            cell_mm=scene.transport.cell_mm,
            seed=scene.transport.seed,
            stripe_wavenumber_per_mm=wavenumber,
            harmonics=harmonics,
            walls=walls,
            n_threads=os.cpu_count() or 1,
            progress=progress,
        )
    seconds = time.process_time() - begun_s
    response = TankResponse(field=sampled, seconds=seconds, from_cache=False)
    _write(kept, response)
    return response


def _key(scene: Scene, period_mm: float, harmonics: tuple[int, ...], walls: Walls | None) -> str:
    """Return the name of a question: a digest of all that its answer depends on."""
    question: dict[str, object] = {
        "version": VERSION,
        "medium": scene.medium.model_dump(),
        "tank": scene.tank.model_dump(exclude_none=True, exclude=NO_LIGHT),
        "beam": scene.beam.model_dump(),
        "transport": {**scene.transport.model_dump(), "tail": scene.tail},
        "period_mm": period_mm,
        "harmonics": harmonics,
    }
    if walls is not None:
        question["walls"] = asdict(walls)
    return hashlib.sha256(json.dumps(question, sort_keys=True).encode()).hexdigest()[:24]


def _read(path: Path) -> TankResponse | None:
    """Return what was kept, None if the file is damaged: it is only a cache."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            field = SampledField(**{f.name: kept[f.name][()] for f in fields(SampledField)})
            seconds = float(kept["seconds"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return TankResponse(field=field, seconds=seconds, from_cache=True)


def _write(path: Path, response: TankResponse) -> None:
    values = {f.name: getattr(response.field, f.name) for f in fields(SampledField)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
        np.savez(part, **values, seconds=np.array(response.seconds))
    Path(part.name).replace(path)
