"""What every model of a configuration file shares."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Role = Literal["stripes", "white", "black", "ambient", "dark", "flat", "board", "grey-code", "ramp"]
MAX_SHIFTS = 1000
Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]


def check_shift(role: str, shift: int | None, shifts: int | None) -> None:
    """Refuse stripes without shift and shifts, and anything else with them."""
    if role != "stripes":
        if shift is not None or shifts is not None:
            msg = f"only role stripes has shift and shifts, not {role}"
            raise ValueError(msg)
    elif shift is None or shifts is None:
        msg = "role stripes needs shift and shifts"
        raise ValueError(msg)
    elif shift >= shifts:
        msg = f"shift {shift} is not below shifts {shifts}"
        raise ValueError(msg)


def check_code(role: str, code: tuple[object, ...], level: float | None) -> None:
    """Refuse a Grey code without axis, bit and polarity, a ramp without level, others with them."""
    given = [part is not None for part in code]
    if role == "grey-code" and not all(given):
        msg = "role grey-code needs axis, bit and polarity"
        raise ValueError(msg)
    if role != "grey-code" and any(given):
        msg = f"only role grey-code has axis, bit and polarity, not {role}"
        raise ValueError(msg)
    if (role == "ramp") != (level is not None):
        msg = "role ramp needs level" if role == "ramp" else f"only role ramp has level, not {role}"
        raise ValueError(msg)


class Model(BaseModel):
    """Frozen; refuses unknown keys, NaN and truth values."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )

    @model_validator(mode="before")
    @classmethod
    def _no_truth_values(cls, content: Any) -> Any:
        """Refuse yes, no, on and off, which YAML 1.1 reads as truth and pydantic as one or zero."""
        if not isinstance(content, dict):
            return content
        for mapping in (content, *(v for v in content.values() if isinstance(v, dict))):
            for key, value in mapping.items():
                if isinstance(value, bool):
                    msg = f"{key} is {str(value).lower()}, a number or a word was expected"
                    raise ValueError(msg)  # noqa: TRY004 - pydantic explains only value errors
        return content
