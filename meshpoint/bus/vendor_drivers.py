"""What python-can's interfaces need on a machine besides python-can, by interface."""

from __future__ import annotations

from typing import Final

DRIVERS: Final = {
    "canalystii": "the Python package canalystii",
    "cantact": "the Python package cantact",
    "etas": "ETAS's BOA, which is for Windows alone",
    "gs_usb": "the Python packages gs_usb and pyusb",
    "iscan": "Thorsis's isCAN driver",
    "ixxat": "HMS's VCI driver for Ixxat, which is for Windows alone",
    "kvaser": "Kvaser's CANlib",
    "neovi": "Intrepid's driver and the Python package python-ics",
    "nican": "National Instruments' NI-CAN, which is for Windows alone",
    "nixnet": "National Instruments' NI-XNET, which is for Windows alone",
    "pcan": "PEAK's PCAN-Basic library",
    "systec": "SYS TEC's USB-CANmodul driver",
    "usb2can": "8devices' USB2CAN driver, which is for Windows alone",
    "vector": "Vector's XL Driver Library, which is for Windows alone",
}

NOT_LOADED: Final = (ImportError, NotImplementedError, NameError, AttributeError)
"""What opening an interface raises where its driver could not be loaded: python-can's modules go on
without the driver's functions, and miss them by name when a bus is opened."""


def driver_words(interface: str, error: Exception) -> str:
    """Why an interface could not be opened, where that is its driver; empty where nothing is known
    of one."""
    needed = DRIVERS.get(interface)
    if isinstance(error, NOT_LOADED):
        return "its driver is not on this machine" + (f": it needs {needed}" if needed else "")
    return "" if needed is None else f"{' '.join(str(error).split())}; it needs {needed}"
