"""Makes calibration records of sessions: which frames serve, and what the record must say."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.dark import DarkMap, fit_dark
from calibration.flat import fit_flat
from calibration.photon_transfer import (
    MARKED_SHARE,
    Level,
    PhotonTransfer,
    fit_photon_transfer,
    measure_level,
)
from calibration.record import Conditions, Kind, NamedArray, Quantity, Record, array
from labrig.config import parse
from labrig.errors import AnalysisRefusedError
from labrig.models.plan import Shot
from labrig.models.setup import Setup
from labrig.session import Session
from labrig.steps.conditions import conditions_of

Picture = NDArray[np.float64]
Frames = Iterator[tuple[float, NDArray[np.uint16]]]


@dataclass(frozen=True, slots=True)
class Source:
    """A session as a calibration reads it: frames by role, one at a time."""

    session: Session
    setup: Setup
    shots: tuple[Shot, ...]

    @classmethod
    def open(cls, path: Path) -> Source:
        """Open a session.

        Raises
        ------
        SessionError, ConfigError, AnalysisRefusedError
            If it cannot be trusted or shots of it are missing.
        """
        session = Session.open(path)
        if session.missing:
            msg = (
                f"session {path.name}: {len(session.missing)} of {len(session.shots)} shots are "
                f"missing ({session.missing[0]} first); capture it anew."
            )
            raise AnalysisRefusedError(msg)
        setup = parse(session.header.get("setup"), Setup, source=f"{path}: setup")
        shots = tuple(parse(s, Shot, source=f"{path}: shot {s['id']!r}") for s in session.shots)
        return cls(session, setup, shots)

    def of(self, *roles: str) -> tuple[Shot, ...]:
        """Return the shots of some roles, in order."""
        return tuple(shot for shot in self.shots if shot.role in roles)

    def needed(self, role: str, why: str) -> tuple[Shot, ...]:
        """Return the shots of a role, refused if there are none."""
        found = self.of(role)
        if not found:
            have = ", ".join(sorted({shot.role for shot in self.shots})) or "nothing"
            msg = (
                f"session {self.session.path.name} holds no frames of role {role} (it has {have}): "
                f"{why}"
            )
            raise AnalysisRefusedError(msg)
        return found

    def read(self, shot: Shot) -> NDArray[np.uint16]:
        """Return the counts of a shot, (rows, cols)."""
        return self.session.read(shot.id)

    def frames(self, shots: tuple[Shot, ...]) -> Frames:
        """Yield exposure and counts of shots, one after the other."""
        for shot in shots:
            yield shot.exposure_s, self.read(shot)

    def mean(self, role: str, **wanted: object) -> Picture | None:
        """Return the mean picture (rows, cols) of the shots of a role; None without any."""
        total: Picture | None = None
        n = 0
        for shot in self.of(role):
            if all(getattr(shot, key) == value for key, value in wanted.items()):
                frame = self.read(shot)
                total = frame.astype(np.float64) if total is None else total + frame
                n += 1
        return None if total is None else total / n

    def conditions(self) -> Conditions:
        """Return the conditions of the session."""
        return conditions_of(self.session, self.setup)

    def digest(self, shots: tuple[Shot, ...]) -> str:
        """Return the SHA-256 of shots: their pixels' digests, roles and exposures."""
        found = hashlib.sha256()
        for shot in sorted(shots, key=lambda s: s.id):
            pixels = self.session.frames[shot.id].xxh3_128
            found.update(f"{shot.role} {shot.exposure_s!r} {pixels}\n".encode())
        return found.hexdigest()

    def record(
        self,
        kind: Kind,
        shots: tuple[Shot, ...],
        quantities: dict[str, Quantity],
        arrays: dict[str, NamedArray],
        *,
        settings: dict[str, Any] | None = None,
        notes: tuple[str, ...] = (),
    ) -> Record:
        """Return a record of what was found in some shots of this session."""
        simulated = ("The session is simulated.",) if self.session.header.get("simulated") else ()
        unsealed = () if self.session.sealed else ("The session is not sealed.",)
        return Record(
            kind=kind,
            created=datetime.now(UTC).replace(microsecond=0),
            conditions=self.conditions(),
            inputs=self.digest(shots),
            n_frames=len(shots),
            quantities=quantities,
            arrays=arrays,
            settings=settings or {},
            notes=(*simulated, *unsealed, *notes),
        )


def dark_map(source: Source) -> tuple[DarkMap, tuple[Shot, ...]]:
    """Return the dark map of a session's dark frames, and these."""
    shots = source.needed("dark", "take some with the lens capped, at two exposures or more.")
    camera = source.setup.camera
    found = fit_dark(source.frames(shots), bits=camera.bits, white_level_dn=camera.white_level_dn)
    return found, shots


def dark_record(source: Source) -> Record:
    """Return offset and dark current of every pixel."""
    found, shots = dark_map(source)
    picture = ("row", "col")
    arrays = {
        "offset": array(picture, found.offset_dn, "DN", "dark level at exposure zero"),
        "hot": array(picture, found.hot.astype(np.uint8), "1", "1 where a pixel stands out"),
    }
    notes = []
    quantities = {
        "offset_dn": Quantity(value=float(found.offset_dn.mean()), unit="DN"),
        "temporal_noise_dn": Quantity(value=found.temporal_variance_dn2**0.5, unit="DN"),
        "mean_exposure_s": Quantity(value=found.mean_exposure_s, unit="s"),
        "spread_s2": Quantity(value=found.spread_s2, unit="s^2"),
    }
    if found.current_dn_per_s is not None:
        arrays["current"] = array(picture, found.current_dn_per_s, "DN/s", "dark current")
        std = (found.temporal_variance_dn2 / found.spread_s2 / found.hot.size) ** 0.5
        quantities["current_dn_per_s"] = Quantity(
            value=float(np.median(found.current_dn_per_s)), std=std, unit="DN/s"
        )
    else:
        notes.append(
            f"All dark frames have {found.exposures_s[0]:g} s: the dark current is unknown, and "
            "the map serves that exposure only."
        )
    settings = {"hot_pixels": int(found.hot.sum()), "exposures_s": list(found.exposures_s)}
    return source.record("dark", shots, quantities, arrays, settings=settings, notes=tuple(notes))


def flat_record(source: Source, dark: DarkMap | None = None) -> Record:
    """Return the relative response of every pixel; without a dark map by the session's own dark."""
    flats = source.needed("flat", "take some of uniform light, at half of the range.")
    used = flats
    if dark is None:
        dark, darks = dark_map(source)
        used = (*flats, *darks)
    camera = source.setup.camera.record()
    found = fit_flat(source.frames(flats), dark, camera)
    picture = ("row", "col")
    arrays = {
        "relative": array(picture, found.relative, "1", "response relative to the median pixel"),
        "variance": array(picture, found.variance, "1", "variance of relative"),
        "usable": array(picture, found.usable.astype(np.uint8), "1", "0 for dead or hot pixels"),
    }
    notes: tuple[str, ...] = ()
    if camera.floor_variance_dn2 is None:
        notes = ("Gain or read noise of the camera is unknown: the map has no variance.",)
    return source.record(
        "flat",
        used,
        {"nonuniformity": Quantity(value=found.nonuniformity, unit="1")},
        arrays,
        settings={"unusable_pixels": int((~found.usable).sum()), "flat_frames": found.n_frames},
        notes=notes,
    )


def levels_of(source: Source, shots: tuple[Shot, ...]) -> list[Level]:
    """Return what the frames of each exposure say; an exposure with one frame is refused."""
    camera = source.setup.camera
    times = sorted({shot.exposure_s for shot in shots})
    return [
        measure_level(
            (source.read(shot) for shot in shots if shot.exposure_s == exposure_s),
            exposure_s,
            bits=camera.bits,
            white_level_dn=camera.white_level_dn,
        )
        for exposure_s in times
    ]


def photon_transfer_record(source: Source) -> Record:
    """Return gain, noise and linearity from pairs of flat and dark frames."""
    why = "take pairs of uniform light at several exposures, and dark pairs at the same."
    flats, darks = source.needed("flat", why), source.needed("dark", why)
    lit = {shot.exposure_s for shot in flats}
    darks = tuple(shot for shot in darks if shot.exposure_s in lit)
    found = fit_photon_transfer(levels_of(source, flats), levels_of(source, darks))
    return source.record(
        "photon-transfer",
        (*flats, *darks),
        _transfer_quantities(found),
        _transfer_arrays(found),
        settings={
            "fitted_levels": int(found.fitted.sum()),
            "marked_exposures_s": list(found.marked_exposures_s),
        },
        notes=_transfer_notes(found),
    )


def _transfer_quantities(found: PhotonTransfer) -> dict[str, Quantity]:
    low, high = found.linearity
    return {
        "gain_dn_per_e": Quantity(value=found.gain_dn_per_e, std=found.gain_std, unit="DN/e"),
        "dark_noise_e": Quantity(value=found.dark_noise_e, std=found.dark_noise_std, unit="e"),
        "dark_level_dn": Quantity(value=found.dark_level_dn, unit="DN"),
        "saturation_e": Quantity(value=found.saturation_e, unit="e"),
        "shutter_offset_s": Quantity(
            value=found.shutter_offset_s, std=found.shutter_offset_std, unit="s"
        ),
        "response_dn_per_s": Quantity(value=found.response_dn_per_s, unit="DN/s"),
        "linearity_low": Quantity(value=low, unit="1"),
        "linearity_high": Quantity(value=high, unit="1"),
        "dsnu_e": Quantity(value=found.dsnu_e, unit="e"),
        "prnu": Quantity(value=found.prnu, unit="1"),
    }


def _transfer_arrays(found: PhotonTransfer) -> dict[str, NamedArray]:
    level = ("exposure",)
    return {
        "exposure": array(level, found.exposures_s, "s", "exposure of the levels"),
        "mean": array(level, found.mean_dn, "DN", "mean, dark taken off"),
        "variance": array(level, found.variance_dn2, "DN^2", "temporal variance, dark taken off"),
        "deviation": array(level, found.deviation, "1", "mean over its line, less one"),
        "fitted": array(level, found.fitted.astype(np.uint8), "1", "1 where fitted"),
    }


def _transfer_notes(found: PhotonTransfer) -> tuple[str, ...]:
    notes = []
    if found.marked_exposures_s:
        times = ", ".join(f"{t:g}" for t in found.marked_exposures_s)
        notes.append(
            f"The shutter offset of {1e6 * found.shutter_offset_s:.1f} us exceeds "
            f"{100 * MARKED_SHARE:.0f} % of the exposures {times} s."
        )
    if not np.isfinite(found.saturation_e):
        notes.append("No exposure was saturated: the full well is not known.")
    left_out = int(np.isnan(found.deviation).sum())
    if left_out:
        notes.append(f"{left_out} exposures were clipped and left out of every fit.")
    return tuple(notes)


RECORDS: dict[str, Callable[[Source], Record]] = {
    "dark": dark_record,
    "flat": flat_record,
    "photon-transfer": photon_transfer_record,
}
