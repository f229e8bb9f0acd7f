"""SI value of one unit: multiply by it to come from the unit, divide to go to it.

speed_rad_s = speed_rpm * RPM        pressure_bar = pressure_pa / BAR
"""

from __future__ import annotations

import math
from typing import Final

RPM: Final = math.pi / 30.0
"""`rad/s` in a revolution a minute."""
DEG: Final = math.pi / 180.0
"""`rad` in a degree."""
TURN: Final = 2.0 * math.pi
"""`rad` in a turn."""
BAR: Final = 1e5
"""`Pa` in a bar."""
MM: Final = 1e-3
"""`m` in a millimetre."""
CM2: Final = 1e-4
"""`m2` in a square centimetre."""
CM3: Final = 1e-6
"""`m3` in a cubic centimetre."""
MS: Final = 1e-3
"""`s` in a millisecond."""
US: Final = 1e-6
"""`s` in a microsecond."""
MS_US: Final = 1e3
"""A millisecond in microseconds, where times are counted in them."""
SECOND_US: Final = 1e6
"""A second in microseconds, where times are counted in them."""
