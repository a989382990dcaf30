"""What all tests share."""

from hypothesis import settings

# The same examples in every run: a change is judged by what it changes, and coverage does not depend on luck. To search
# for new ones: pytest --hypothesis-profile=default.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")
