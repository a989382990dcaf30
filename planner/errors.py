"""The planner's error root."""


class PlannerError(ValueError):
    """A problem, plan or planner setting is wrong; the message says what, where and what to do."""
