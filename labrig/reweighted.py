"""A result whose bounces are those of another scattering coefficient (Eq. 11)."""

from __future__ import annotations

from dataclasses import replace

from analysis.reweighting import reweight as weighted
from labrig.errors import AnalysisRefusedError
from labrig.results import Result

FIRST_BOUNCE = {"fluence": 1, "light_field": 2}


def reweight(result: Result, sigma_s_per_length: float) -> Result:
    """Return a result with the bounces, and the sigma_s, of another scattering coefficient.

    Raises
    ------
    AnalysisRefusedError
        If the result holds no bounces.
    AnalysisError
        If sigma_s is negative, or that of the result is not positive.
    """
    name = f"sigma_s_per_{result.run.get('length_unit')}"
    if "fluence" not in result.fields or name not in result.run:
        msg = f"{result.path}: holds no bounces to weight; analyse the session to the end."
        raise AnalysisRefusedError(msg)
    sigma_s = float(result.run[name]["value"])
    fields = {
        key: replace(
            result.fields[key],
            values=weighted(
                result.fields[key].values,
                first=first,
                sigma_s_per_mm=sigma_s,
                wanted_per_mm=sigma_s_per_length,
            ),
        )
        for key, first in FIRST_BOUNCE.items()
        if key in result.fields
    }
    run = {**result.run, name: {"value": sigma_s_per_length, "std": None}}
    return replace(result, run=run, fields={**result.fields, **fields})
