"""The one base error of the analysis."""


class AnalysisError(ValueError):
    """Raised when data or parameters admit no trustworthy answer; the message says why."""
