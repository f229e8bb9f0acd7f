"""The messages and enumerations of the DBC as Python classes in SI units, made at import.

`messages.pyi`, written by `python -m meshpoint.dbc.stubs`, says what there is. Every field has the
DBC's start value as its default, so `ValveCommand()` means "everything off now".
"""

from functools import reduce as _reduce
from operator import or_ as _or

from meshpoint.dbc.layout import CODECS as _CODECS
from meshpoint.dbc.layout import ENUMS as _ENUMS

MESSAGE_TYPES = {name: codec.message_type for name, codec in _CODECS.items()}
Message = _reduce(_or, MESSAGE_TYPES.values())

globals().update(_ENUMS)
globals().update(MESSAGE_TYPES)
