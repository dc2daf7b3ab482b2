"""What can go wrong with a device."""


class DriverError(Exception):
    """Raised when a device does not do what it was asked; base of all below."""


class SettingRefusedError(DriverError):
    """Raised when a device cannot take a setting; nothing was changed."""


class NoFrameError(DriverError):
    """Raised when no frame came before the deadline."""


class NotOpenError(DriverError):
    """Raised when a device is used before ``open`` or after ``close``."""
