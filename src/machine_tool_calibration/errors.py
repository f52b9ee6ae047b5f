"""The errors that reach the user as one clear line."""

__all__ = ["CalibrationError", "ModelError", "SessionError"]


class CalibrationError(ValueError):
    """The input or the request is wrong; the message says what and where, in one line."""


class SessionError(CalibrationError):
    """A session, recording or table that cannot be used as it is."""


class ModelError(CalibrationError):
    """A model that the data or the machine does not allow."""
