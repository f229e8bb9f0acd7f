"""The messages and enumerations of the DBC as Python classes in SI units, made at import.

`messages.pyi`, written by `python -m dbc.stubs`, says what there is. Every field has the DBC's start
value as its default, so that `ValveCommand()` means "everything off now".
"""

from functools import reduce
from operator import or_

from dbc.layout import CODECS, ENUMS

MESSAGE_TYPES = {name: codec.message_type for name, codec in CODECS.items()}
Message = reduce(or_, MESSAGE_TYPES.values())

globals().update(ENUMS)
globals().update(MESSAGE_TYPES)

__all__ = ["MESSAGE_TYPES", "Message"]
__all__ += [*ENUMS, *MESSAGE_TYPES]
