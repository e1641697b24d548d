"""Any frame of classic CAN, for hypothesis."""

from can import Message
from hypothesis import strategies as st


@st.composite
def frames(draw: st.DrawFn) -> Message:
    """Standard or extended, data or remote, any identifier and length."""
    is_extended, is_remote = draw(st.booleans()), draw(st.booleans())
    data = b"" if is_remote else draw(st.binary(max_size=8))
    return Message(
        arbitration_id=draw(st.integers(0, 0x1FFFFFFF if is_extended else 0x7FF)),
        is_extended_id=is_extended,
        is_remote_frame=is_remote,
        dlc=draw(st.integers(0, 8)) if is_remote else len(data),
        data=data,
    )
