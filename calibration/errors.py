"""The one base error of the calibration."""


class CalibrationError(ValueError):
    """Raised when counts cannot be turned into radiance; the message says why."""
