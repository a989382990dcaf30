"""The words between the motion-capture child and its parent."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.mocap_child import FRAME, frame, parse_frame

NUMBERS = st.floats(width=32, allow_nan=False)
NAMES = st.text(max_size=60)
BODIES = st.lists(
    st.tuples(NAMES, st.tuples(NUMBERS, NUMBERS, NUMBERS), st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS)), max_size=8
)


@given(st.floats(min_value=0, max_value=1e9), BODIES)
def test_what_is_packed_is_what_is_read(stamp_s: float, bodies: list) -> None:
    message = frame(stamp_s, bodies)
    assert message[:1] == FRAME
    assert parse_frame(message) == (stamp_s, bodies)
