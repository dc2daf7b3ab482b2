"""The calibration records that a session or an analysis names, checked and ready to use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.contrast import ContrastAtDepth, StripeTransfer
from calibration.dark import DarkMap
from calibration.entry import Entry
from calibration.flat import FlatField
from calibration.geometry import Lens, Plane
from calibration.model import CameraModel
from calibration.projector import ProjectorGamma
from calibration.record import Conditions, Record, validity
from calibration.response import table_response
from labrig.calibration_records import read_record
from labrig.errors import AnalysisRefusedError
from labrig.models.analysis import Analysis
from labrig.models.calibration import RecordFile
from labrig.models.setup import Setup
from labrig.session import Session
from labrig.steps.conditions import conditions_of

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Projected:
    """What a projector record knows: by axis where it shines and what contrast arrives.

    Attributes
    ----------
    position_px : by axis, (rows, cols) of the camera's picture, projector px; NaN where unknown
    transfer : by axis, contrast of stripes against their period
    contrast : c1 against depth, if it was measured
    gamma : light against grey level, if it was measured
    """

    position_px: Mapping[str, Array]
    transfer: Mapping[str, StripeTransfer]
    contrast: ContrastAtDepth | None
    gamma: ProjectorGamma | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrections:
    """What is known beyond the session; None where no record was named.

    Attributes
    ----------
    camera : the session's camera with what records say of it
    entry : lit side, and where light enters and which way it goes, px of the captured picture
    used : id, path and digest of every record, for a result's provenance
    """

    camera: CameraModel
    dark: DarkMap | None = None
    flat: FlatField | None = None
    view: tuple[Lens, Plane] | None = None
    entry: tuple[str, Entry] | None = None
    projected: Projected | None = None
    notes: tuple[str, ...] = ()
    used: Mapping[str, Any] = field(default_factory=dict)


def gather(session: Session, setup: Setup, config: Analysis) -> Corrections:
    """Read the records that the session's header and the analysis name; the latter win.

    Raises
    ------
    ConfigError
        If a record cannot be read.
    AnalysisRefusedError
        If a record is of another kind than it is named for, or does not hold for this session.
    """
    kept = dict(session.header.get("calibration") or {})
    kept.pop("projector_latency", None)  # served the capture, and stands in the header itself
    named = {**kept, **config.calibration}
    current = conditions_of(session, setup)
    found = Corrections(camera=setup.camera.record())
    for kind, path in named.items():
        file, record = read_record(Path(path))
        if record.kind != kind:
            msg = f"{path} is a record of {record.kind}, it was named as {kind}; name it rightly."
            raise AnalysisRefusedError(msg)
        notes = _checked(file, record, current, Path(path))
        used = {kind: {"id": file.id, "path": str(path), "sha256": record.inputs}}
        found = replace(
            _with(found, record), notes=(*found.notes, *notes), used={**found.used, **used}
        )
    return found


def shone(setup: Setup, known: Corrections) -> tuple[Setup, Corrections]:
    """Return the setup with the light of grey stripes by the projector's gamma, and what to note.

    Black and white stripes need none: their levels are the ends of every gamma.
    """
    stripes = setup.stripes
    if stripes is None or stripes.levels is None:
        return setup, known
    gamma = known.projected.gamma if known.projected is not None else None
    if gamma is None:
        note = "The gamma of the projector is unknown: grey levels of stripes were taken for light."
        return setup, replace(known, notes=(*known.notes, note))
    low, high = (float(v) for v in gamma.light_at(np.asarray(stripes.levels)))
    stripes = stripes.model_copy(update={"low": low, "high": high})
    return setup.model_copy(update={"stripes": stripes}), known


def _checked(file: RecordFile, record: Record, current: Conditions, path: Path) -> tuple[str, ...]:
    """Return what to note of a record; refuse one that does not hold."""
    differences = validity(record, current, datetime.now(UTC))
    fatal = [d.text for d in differences if d.fatal]
    if fatal:
        msg = (
            f"{path}: the {record.kind} record does not hold for this session: "
            f"{'; '.join(fatal)}. Calibrate anew, or leave the record out."
        )
        raise AnalysisRefusedError(msg)
    told = [d.text for d in differences]
    notes = [f"The {record.kind} record {file.id} was used."]
    if told:
        notes = [f"The {record.kind} record {file.id} was used, though {'; '.join(told)}."]
    return tuple(notes)


def _with(found: Corrections, record: Record) -> Corrections:
    """Return corrections with one more record understood."""
    match record.kind:
        case "dark":
            return replace(found, dark=dark_of(record))
        case "flat":
            return replace(found, flat=_flat_of(record))
        case "photon-transfer":
            return replace(found, camera=_camera_of(found.camera, record))
        case "response":
            return replace(found, camera=_answering(found.camera, record))
        case "geometry":
            return replace(found, view=_view_of(record), entry=_entry_of(record))
        case "projector":
            return replace(found, projected=_projected_of(record))


def dark_of(record: Record) -> DarkMap:
    """Return the dark map of a record."""
    current = record.arrays.get("current")
    return DarkMap(
        offset_dn=record.arrays["offset"].values,
        current_dn_per_s=None if current is None else current.values,
        temporal_variance_dn2=record.quantities["temporal_noise_dn"].value ** 2,
        exposures_s=tuple(record.settings["exposures_s"]),
        mean_exposure_s=record.quantities["mean_exposure_s"].value,
        spread_s2=record.quantities["spread_s2"].value,
        n_frames=record.n_frames,
        hot=record.arrays["hot"].values.astype(bool),
    )


def _flat_of(record: Record) -> FlatField:
    return FlatField(
        relative=record.arrays["relative"].values,
        variance=record.arrays["variance"].values,
        usable=record.arrays["usable"].values.astype(bool),
        nonuniformity=record.quantities["nonuniformity"].value,
        n_frames=int(record.settings["flat_frames"]),
    )


def _camera_of(camera: CameraModel, record: Record) -> CameraModel:
    values = {name: record.quantities[name].value for name in record.quantities}
    return replace(
        camera,
        gain_dn_per_e=values["gain_dn_per_e"],
        read_noise_e=values["dark_noise_e"],
        shutter_offset_s=values["shutter_offset_s"],
    )


def _answering(camera: CameraModel, record: Record) -> CameraModel:
    if "linear" not in record.arrays:
        return camera
    table = record.arrays["linear"].values
    return replace(camera, response=table_response("fitted", table))


def _view_of(record: Record) -> tuple[Lens, Plane]:
    arrays, quantities = record.arrays, record.quantities
    rows, cols = record.settings["shape"]
    names = ("focal_x_px", "focal_y_px", "centre_x_px", "centre_y_px")
    lens = Lens(
        matrix=arrays["matrix"].values,
        distortion=arrays["distortion"].values,
        matrix_std=np.array([quantities[name].std or np.nan for name in names]),
        rms_px=quantities["reprojection_rms_px"].value,
        shape=(rows, cols),
        n_views=int(record.settings["views"]),
    )
    plane = Plane(
        homography=arrays["homography"].values,
        rms_mm=quantities["plane_rms_mm"].value,
        mm_per_px=quantities["mm_per_px"].value,
        n_corners=len(arrays["corner_px"].values),
    )
    return lens, plane


def _entry_of(record: Record) -> tuple[str, Entry] | None:
    if "lit_side" not in record.settings:
        return None
    found = record.quantities
    return str(record.settings["lit_side"]), Entry(
        face_x=found["face_px"].value,
        axis_y=found["axis_px"].value,
        angle_deg=found["beam_angle_deg"].value,
        angle_std_deg=found["beam_angle_deg"].std or 0.0,
    )


def _projected_of(record: Record) -> Projected:
    axes = [axis for axis in ("x", "y") if f"map_{axis}" in record.arrays]
    values = {name: quantity.value for name, quantity in record.quantities.items()}
    return Projected(
        position_px={axis: record.arrays[f"map_{axis}"].values for axis in axes},
        transfer={
            axis: StripeTransfer(
                level=values[f"contrast_{axis}_level"],
                reach_px=values[f"contrast_{axis}_reach_px"],
                exponent=values[f"contrast_{axis}_exponent"],
                periods_px=record.arrays[f"period_{axis}"].values,
                measured=record.arrays[f"contrast_{axis}"].values,
                residual=values[f"contrast_{axis}_residual"],
            )
            for axis in axes
            if f"contrast_{axis}_level" in values
        },
        contrast=_contrast_of(record, values),
        gamma=_gamma_of(record, values),
    )


def _gamma_of(record: Record, values: Mapping[str, float]) -> ProjectorGamma | None:
    if "light" not in record.arrays:
        return None
    return ProjectorGamma(
        levels=record.arrays["level"].values,
        light=record.arrays["light"].values,
        exponent=values["gamma"],
        residual=values["gamma_residual"],
    )


def _contrast_of(record: Record, values: Mapping[str, float]) -> ContrastAtDepth | None:
    if "c1_a0" not in values:
        return None
    return ContrastAtDepth(
        coefficients=(values["c1_a0"], values["c1_a1"], values["c1_a2"]),
        covariance=np.diag([(record.quantities[f"c1_a{k}"].std or 0.0) ** 2 for k in range(3)]),
        depth_range=(values["c1_from"], values["c1_to"]),
        unit=record.quantities["c1_from"].unit,
        period_px=values["c1_period_px"],
        depth=record.arrays["c1_depth"].values,
        measured=record.arrays["c1"].values,
    )
