"""The drivers' error root."""


class DriverError(RuntimeError):
    """A vehicle or a motion-capture system failed; the message says which, what and what to do."""
