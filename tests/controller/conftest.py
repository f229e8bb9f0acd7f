"""What the statements about the controller share; makes this folder's helper importable."""

import sys
from pathlib import Path

import pytest

from meshpoint.controller.settings.header import RunHeader, new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet, load_sheet

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def sheet() -> GearboxSheet:
    return load_sheet("thesis")


@pytest.fixture
def header(sheet: GearboxSheet) -> RunHeader:
    return new_header("1.2.3", sheet, ControllerSettings())
