"""The state of the edge gate (`edge_gate`), row by row, and what tunes it.

Two arrays hold a gate: counts (COUNTS,) int64 and quantities (QUANTITIES,) float64. A name here is
the place of one of them, or a bound that the gate's kernels share.
"""

from __future__ import annotations

from typing import Final

# --- the counts of a gate, int64 --------------------------------------------------------------
MODE: Final = 0
TIME: Final = 1
"""Sensor time of the last edge that got a tooth, us, and its tooth."""
TOOTH: Final = 2
LAST: Final = 3
"""+ polarity: tooth of its last edge."""
NEXT: Final = 5
"""+ polarity: the first of its edges that is not used up."""
REJECTED: Final = 7
"""Edges without a tooth since the last one with."""
SLOT: Final = 8
"""The tooth that `judge` sees in an edge."""
GUESS: Final = 9
"""In doubt: the tooth that the newest rising edge has if the count is right."""
GAPS: Final = 10
"""Gaps seen since the search for the pattern of missing teeth began."""
GAP_HITS: Final = 11
"""Edges where the wheel has no tooth, since the last rising edge."""
EXTRA: Final = 12
"""How many edges were left out, were missing, how often the tooth was in doubt and was lost."""
MISSED: Final = 13
DOUBTS: Final = 14
LOST: Final = 15
FOUND_US: Final = 16
"""When teeth were first numbered; 0 before."""
FALLING: Final = 17
"""Polarity of the last edge with a tooth."""
STOPS: Final = 18
"""How often of LOST the wheel was slow or stood."""
SEARCHED: Final = 19
"""Pitches since the search began."""
WIDEST: Final = 20
"""The widest gap of the wheel, pitches."""
DRAGGED: Final = 21
"""1 while a synchroniser drags the shaft to another speed: none tells where an edge is due then, so
each edge is taken for the next one."""
COUNTS: Final = 22

SEEKING, SEARCHING, COUNTING = range(3)
"""Modes: no steady speed yet; a speed, but not yet the place of the missing teeth; each edge gets
its tooth."""
UNKNOWN: Final = -(1 << 62)

# --- its quantities, float64 --------------------------------------------------------------------
RATE: Final = 0
"""Pitches a microsecond."""
LAG: Final = 1
"""Filtered angle less that of the last edge, pitches."""
AT: Final = 2
"""Place of the last edge in its pitch: 0 rising, the duty falling."""
DUTY: Final = 3
SCATTER: Final = 4
"""Mean distance of edges from where they were expected, pitches."""
ERROR: Final = 5
"""Of the edge that is judged, against its slot, pitches."""
LEAST_RATE: Final = 6
"""Below it the wheel may stand still within three pitches."""
BEND: Final = 7
"""Half the largest acceleration, pitches/us^2."""
MOST_RATE: Final = 8
"""Edges that come faster are noise."""
QUANTITIES: Final = 9

MOST_RAD_S: Final = 630.0
"""6,000 rpm, what a data sheet allows."""
RUN: Final = 4
"""Intervals in a row of about one length: then there is a speed."""
LONGER, LONGER_ERRATIC = 1.25, 1.5
"""One length: up to this factor between neighbours; more where missing teeth check the count."""
IN_TURN: Final = 0.4
"""An edge this near to where the next one is due is that one, pitches; less after a wrong edge."""
AFTER_REJECTED: Final = 0.25
OUT_OF_TURN: Final = 0.25
HOLE: Final = 0.75
"""Without an edge of either polarity for this much longer than expected, teeth are missing."""
MOST_MISSING: Final = 2
RATE_ERROR: Final = 0.03
"""What the filtered speed may be wrong by, as a share."""
GAP_RATIO: Final = 1.45
"""A gap looks longer or shorter than it is by less than this factor."""
MOST_REJECTED: Final = 60
LONG: Final = 2.0
"""At the least speed, a wheel may stop within so many pitches."""
FOLLOW, FOLLOW_RATE, MOST_ERROR = 0.6, 0.3, 0.15
"""alpha, beta, and the largest error that moves the speed."""
MOST_DRAGGED: Final = 0.4
"""The same in a shaft that is dragged, by over 2,000 rad/s2: its speed is that of the last edge."""
LONGEST_WAIT: Final = 1.5
"""An edge waits for the next of its polarity until the other one is so many pitches on."""
SURE, SURE_SCATTERS, BETTER = 0.02, 3.0, 0.02
SCATTER_SHARE, START_SCATTER, LEAST_SCATTER, MOST_SCATTER = 0.0625, 0.05, 0.002, 0.2
CLEAN, WIDER, ERRATIC, TWO_TEETH = 0.04, 6.0, 0.1, 0.6
"""From this scatter on an edge may be further off; above the third a whole wheel has no
count. On an erratic wheel edges so far apart (pitches) may be those of two teeth."""
DUTY_SHARE: Final = 0.02
