"""The two frames of authentication, from a DBC of their own: who does not use them does not see a
change in the wire contract, nor in its hash."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from meshpoint.dbc.e2e import COUNTER_MODULUS, check_crc, write_crc
from meshpoint.dbc.fields import make_enums
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import Codec, make_codec
from meshpoint.dbc.schema import parse_schema
from meshpoint.dbc.source import DBC_PATH

AUTHENTICATION_DBC: Final = DBC_PATH.with_name("authentication.dbc")
_SCHEMA: Final = parse_schema(AUTHENTICATION_DBC.read_bytes(), AUTHENTICATION_DBC.name)
_ENUMS: Final = make_enums(_SCHEMA)
_CODECS: Final = {spec.name: make_codec(spec, _ENUMS) for spec in _SCHEMA.messages}


class Channel:
    """One of the two messages: its frames and what is in them."""

    def __init__(self, codec: Codec) -> None:
        data_id = codec.spec.data_id
        if data_id is None:
            raise ValueError(f"{codec.spec.name}: no E2E data ID")
        self.can_id: Final = codec.spec.can_id
        self.message: Final[Callable[..., Any]] = codec.message_type
        self._codec = codec
        self._data_id = data_id

    def encode(self, counter: int, message: Any) -> Frame:
        """The frame; `counter` is that of the frame before."""
        buffer = bytearray(self._codec.spec.length)
        self._codec.encode(buffer, counter % COUNTER_MODULUS, message)
        write_crc(buffer, self._data_id)
        return Frame(self.can_id, bytes(buffer))

    def decode(self, frame: Frame) -> Any:
        """What is in a frame; None where it is not this message or is damaged."""
        can_id, data, is_fd, is_extended = frame
        if can_id != self.can_id or not (is_fd and is_extended):
            return None
        if len(data) != self._codec.spec.length or not check_crc(data, self._data_id):
            return None
        return self._codec.decode(data)


PROOF: Final = Channel(_CODECS["CommandProof"])
CHALLENGE: Final = Channel(_CODECS["FreshnessChallenge"])
