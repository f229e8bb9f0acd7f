"""The C code's structures as its headers have them, for tests that call single functions."""

from __future__ import annotations

import ctypes as c


class CFrame(c.Structure):
    """struct frame"""

    _fields_ = (("id", c.c_uint32), ("length", c.c_uint8), ("is_extended", c.c_bool),
                ("is_fd", c.c_bool), ("data", c.c_uint8 * 64))  # fmt: skip


class CScan(c.Structure):
    """struct hal_scan"""

    _fields_ = (("sleeve_um", c.c_int16 * 4), ("brake_20pa", c.c_uint16),
                ("supply_20pa", c.c_uint16), ("oil_centidegree", c.c_uint16),
                ("clutch_basispoint", c.c_uint16), ("bad_sleeves", c.c_uint8))  # fmt: skip


class CEdgeRead(c.Structure):
    """struct edge_read"""

    _fields_ = (("read_us", c.c_uint32), ("newest_index", c.c_uint16), ("valid_stamps", c.c_uint8),
                ("long_interval", c.c_bool), ("stopped", c.c_bool), ("sensor_fault", c.c_bool),
                ("stamps_us", c.c_uint16 * 27))  # fmt: skip


class CEdgeChannel(c.Structure):
    """struct edge_channel"""

    _fields_ = (("low_us", c.c_uint16 * 27), ("newest", c.c_uint8), ("valid", c.c_uint8),
                ("index", c.c_uint16), ("newest_us", c.c_uint32), ("long_gaps", c.c_uint32),
                ("is_idle", c.c_bool))  # fmt: skip


class CReport(c.Structure):
    """struct valve_report"""

    _fields_ = (("sample_us", c.c_uint32), ("energised", c.c_uint16), ("pending", c.c_uint16),
                ("refused_count", c.c_uint16), ("expired_count", c.c_uint16))  # fmt: skip


class COrder(c.Structure):
    """struct valve_order"""

    _fields_ = (("action", c.c_uint), ("time_us", c.c_uint32))


class CChannel(c.Structure):
    """struct e2e_channel"""

    _fields_ = (("state", c.c_uint), ("oks", c.c_uint16), ("errors", c.c_uint16),
                ("counter", c.c_uint8), ("has_counter", c.c_bool), ("is_heard", c.c_bool),
                ("heard_us", c.c_uint32))  # fmt: skip


class CActivation(c.Structure):
    """struct activation"""

    _fields_ = (("is_set", c.c_bool), ("on", c.c_bool), ("at_us", c.c_int64))


class CSlot(c.Structure):
    """struct valve_slot"""

    _fields_ = (("is_on", c.c_bool), ("pending", CActivation), ("passed", CActivation),
                ("refused", CActivation))  # fmt: skip


class CValves(c.Structure):
    """struct valves"""

    _fields_ = (("slots", CSlot * 9), ("clock_us", c.c_int64), ("is_held", c.c_bool),
                ("expiry_us", c.c_uint32), ("refused_count", c.c_uint16),
                ("expired_count", c.c_uint16))  # fmt: skip


class CCommand(c.Structure):
    """struct command"""

    _fields_ = (("has_orders", c.c_bool), ("has_clutch", c.c_bool), ("close_clutch", c.c_bool),
                ("orders", COrder * 9))  # fmt: skip
