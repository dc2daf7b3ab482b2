"""What can go wrong in a measurement: one tree of errors, printed once, by the CLI or the GUI.

A message is one line: what was found, what was wanted, what to do.
"""


class LabrigError(Exception):
    """Raised when labrig cannot do what it was asked; the base of every error of this room."""


class ConfigError(LabrigError):
    """Raised when a YAML file or a setting cannot be understood."""


class PlanError(LabrigError):
    """Raised when a capture plan contradicts itself or asks what the rig cannot do."""


class SessionError(LabrigError):
    """Raised when a session folder cannot be written as asked or read as promised."""


class SessionLockedError(SessionError):
    """Raised when another process is writing the session."""


class AnalysisRefusedError(LabrigError):
    """Raised when a session does not hold what a trustworthy analysis needs."""


class RunError(LabrigError):
    """Raised when a capture run cannot start or go on."""
