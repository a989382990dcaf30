"""The simulators' error root."""


class SimulationError(ValueError):
    """A simulated world or a fault is described wrongly; the message says what, where and what to do."""
