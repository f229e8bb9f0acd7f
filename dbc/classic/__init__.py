"""The classic profile of the wire contract: the same gearbox on 500 kbit/s and frames of 8 bytes.

`contract` says what is in each frame, in terms of meshpoint.dbc; `make` writes
`meshpoint_classic.dbc` from that; `codecs` reads the file back and encodes and decodes. Which of
our frames become which of these, and back, is in `meshpoint.bus.classic`.
"""
