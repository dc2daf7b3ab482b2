"""Makes the record of a camera's response: of an exposure ramp, or of patterns and inverses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.record import NamedArray, Quantity, Record, array
from calibration.response import (
    LINEAR_WITHIN,
    MAX_FITTED_BITS,
    PowerResponse,
    Ramp,
    Response,
    deviations_of,
    fit_response,
    linearity_of,
    power_of_pairs,
    sample_ramp,
)
from labrig.calibrating.camera import Source
from labrig.calibrating.inverses import Pairs
from labrig.models.plan import Shot

Array = NDArray[np.float64]

MAX_RAMP = 12  # frames of a ramp that are held at once
WORTH = 0.2  # a response that leaves more than this of the closures does not explain them


def response_record(source: Source) -> Record:
    """Return the linearity of a linear camera, or the fitted response of one that is not.

    Raises
    ------
    AnalysisRefusedError
        If the session holds neither a ramp nor patterns with their inverses.
    CalibrationError
        If they do not determine a response.
    """
    role = "flat" if source.of("flat") else "white"
    few = len({shot.exposure_s for shot in source.of(role)}) < 3
    pairs = Pairs.of(source) if few and source.setup.camera.bits <= MAX_FITTED_BITS else None
    return _of_ramp(source, role) if pairs is None else _of_pairs(source, pairs)


def _of_ramp(source: Source, role: str) -> Record:
    why = (
        "take one unchanged scene at three exposures or more (role white), or patterns with their "
        "inverses, white and black."
    )
    shots = source.needed(role, why)
    first = {shot.exposure_s: shot for shot in reversed(shots)}
    chosen = tuple(first[t] for t in sorted(first))
    if len(chosen) > MAX_RAMP:
        chosen = tuple(chosen[k] for k in np.linspace(0, len(chosen) - 1, MAX_RAMP).astype(int))
    camera = source.setup.camera
    ramp = Ramp(
        counts=sample_ramp([source.read(shot) for shot in chosen]),
        exposures_s=np.array([shot.exposure_s for shot in chosen]),
        bits=camera.bits,
        black_level_dn=_black_level(source),
        white_level_dn=camera.white_level_dn,
    )
    off = linearity_of(ramp)
    quantities = {"linearity_rms": Quantity(value=off, unit="1")}
    level = ("exposure",)
    arrays = {
        "exposure": array(level, ramp.exposures_s, "s", "exposures of the ramp"),
        "deviation": array(level, deviations_of(ramp), "1", "over proportional counts, less 1"),
    }
    response = None if off <= LINEAR_WITHIN else fit_response(ramp)
    return _record(source, chosen, quantities, arrays, off, response)


def _of_pairs(source: Source, found: Pairs) -> Record:
    """Return the power under which patterns and inverses add to white and black.

    It is fitted to either half of the picture and judged by the other.
    """
    camera, black_level = source.setup.camera, _black_level(source)
    sides = [found.seen(source, black_level, half) for half in ("left", "right")]
    fits = [power_of_pairs(*side, camera.bits) for side in sides]
    as_it_is = np.mean([PowerResponse(1.0).closures(*side) for side in sides], axis=0)
    judged = list(zip(reversed(fits), sides, strict=True))
    fitted = np.mean([fit.closures(*side) for fit, side in judged], axis=0)
    before = np.mean([PowerResponse(1.0).by_mixture(*side) for side in sides], axis=0)
    after = np.mean([fit.by_mixture(*side) for fit, side in judged], axis=0)
    power = PowerResponse(float(np.mean([fit.power for fit in fits])))
    off = abs(power.at_half)
    if off > LINEAR_WITHIN and np.linalg.norm(after) > WORTH * np.linalg.norm(before):
        msg = (
            "patterns and inverses miss white and black by {:.1f} % where half lit and {:.1f} % "
            "elsewhere, and by {:.1f} and {:.1f} % with the response of the picture's other half: "
            "it is not the camera's response. Take a ramp of exposures."
        ).format(*(100.0 * before), *(100.0 * after))
        raise CalibrationError(msg)
    std = abs(fits[0].power - fits[1].power) / 2.0
    quantities = {
        "power": Quantity(value=power.power, std=std, unit="1"),
        "half_light_deviation": Quantity(value=power.at_half, unit="1"),
        **{
            f"closure_{where}{how}": Quantity(value=float(value), unit="1")
            for how, found_there in (("", before), ("_fitted", after))
            for where, value in zip(("half_lit", "elsewhere"), found_there, strict=True)
        },
    }
    pair = ("pair",)
    arrays = {
        "pair_period": array(pair, found.periods_px, "projector px", "of the pattern"),
        "pair_closure": array(pair, as_it_is, "1", "(P + P_inv)/(W + B) - 1 of the counts"),
        "pair_closure_fitted": array(pair, fitted, "1", "with the other half's response"),
    }
    response = power.response(camera.bits, black_level) if off > LINEAR_WITHIN else None
    notes = (
        "Found where patterns and inverses add to white and black, fitted closures by the response "
        "of the picture's other half. A ramp of exposures would owe nothing to the projector.",
    )
    return _record(source, found.shots, quantities, arrays, off, response, notes)


def _record(
    source: Source,
    used: tuple[Shot, ...],
    quantities: dict[str, Quantity],
    arrays: dict[str, NamedArray],
    off: float,
    response: Response | None,
    notes: tuple[str, ...] = (),
) -> Record:
    """Return a record that says how far the camera is off a line, with the table if it has one."""
    if response is None:
        told = (
            f"The camera is linear within {100 * off:.2f} % (limit {100 * LINEAR_WITHIN:.0f} %): "
            "no response was fitted."
        )
    else:
        told = (
            f"The camera departs from a line by {100 * off:.0f} %: a response was fitted. Its gain "
            "and noise in linear counts are unknown, so that merged pictures have no variance."
        )
        arrays = arrays | {
            "count": array(("count",), np.arange(response.table.size), "DN", "of the camera"),
            "linear": array(("count",), response.table, "DN", "linear counts, to the same white"),
        }
    return source.record(
        "response",
        used,
        quantities,
        arrays,
        settings={"response": "linear" if response is None else "fitted"},
        notes=(told, *notes),
    )


def _black_level(source: Source) -> float:
    """Return the mean of the dark frames, DN; without any the camera's declared black level."""
    darks = source.of("dark")
    if not darks:
        return source.setup.camera.black_level_dn
    return float(np.mean([source.read(shot).mean() for shot in darks]))
