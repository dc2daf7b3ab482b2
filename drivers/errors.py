"""What can go wrong with a device."""


class DriverError(Exception):
    """Raised when a device does not do what it was asked; base of all below."""


class DeviceNotFoundError(DriverError):
    """Raised when no device answers to the name that was given; the message says the remedy."""


class DeviceBusyError(DriverError):
    """Raised when another program holds the device; the message names it where it is known."""


class AccessDeniedError(DriverError):
    """Raised when the system denies this user a device; the message says which rule to install."""


class DeviceLostError(DriverError):
    """Raised when an open device has gone: unplugged, powered off, its control taken away."""


class NotOpenError(DriverError):
    """Raised when a device is used before ``open`` or after ``close``."""


class SettingRefusedError(DriverError):
    """Raised when a device cannot take a setting; nothing was changed."""


class DeadlineError(DriverError):
    """Raised when a device did not answer before the deadline, other than with a frame."""


class NoFrameError(DriverError):
    """Raised when no frame came before the deadline."""


class FrameCorruptError(DriverError):
    """Raised when a frame came of which no picture can be made; the next one may be whole."""


class TriggerNotFiredError(DriverError):
    """Raised when a trigger knows that it gave no pulse; never counted as a lost frame."""


class CancelledError(DriverError):
    """Raised out of a wait whose cancel token was set; the device is as it was before."""
