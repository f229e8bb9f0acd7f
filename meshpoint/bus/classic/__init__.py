"""The classic profile on a node's way to the bus: our frames become frames of 8 bytes, and back.

The cores know one wire contract, that of meshpoint.dbc. `cores` stands around each of them where
the bus is classic: it packs what the core sends, and unpacks what it is to hear. What the E2E
protection finds out there is handed on: a damaged frame reaches the core as a damaged one, a lost
one as a step of the counter, so that the core's own checks judge as they do on CAN FD.
"""
