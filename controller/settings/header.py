"""The run header: all a replay needs to build the same controller again.

It is saved beside the log under the name of its hash, and the hash is in every status frame; so a
log finds its header, and a header that was changed is noticed.

It says as well what the last bit of a result depends on beside the code: libraries, processor, C
library. Not on Python's minor version, as long as nothing adds floats by `sum`, which is
compensated from 3.12 on. OpenBLAS has other kernels for other processors, and the C library takes
FMA where there is one; both then round otherwise.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import platform
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from meshpoint.controller.settings.learned import Calibration, read_calibration
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.strategy_file import FORM, StrategyFile, is_file_name
from meshpoint.dbc import DBC_SHA256
from meshpoint.dbc.messages import ControllerStatus
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.reading import UnreadableError, read_bounded
from meshpoint.gearbox.sheet import sheet_from_canonical
from meshpoint.gearbox.tables import TableError, read_values

LIBRARIES: Final = ("numpy", "numba")
SIZES: Final = (4, 7, 30)
"""Of the matrices tried: OpenBLAS works on blocks, and on what is left over."""
ELEMENTARY: Final = (math.exp, math.sin, math.cos)
NUMBERS: Final = 3_000
"""Of a thousand values of these functions one is rounded otherwise without FMA (glibc 2.36)."""

HEADER_LIMIT_BYTES: Final = 4 * 1024 * 1024


@cache
def arithmetic() -> str:
    """The libraries that compute, the C library, and a digest of what they make here of fixed
    numbers; equal where the same steps give the same bytes."""
    parts = [f"{name} {version(name)}" for name in LIBRARIES]
    parts.append(" ".join(platform.libc_ver()).strip() or platform.system())
    return ", ".join((*parts, f"rounding {rounding()}"))


def rounding() -> str:
    """The digest, eight characters; 2 ms."""
    hashed = hashlib.sha256()
    numbers = np.arange(1.0, NUMBERS + 1.0) * 0.618034 % 1.0 * 10.0
    for function in ELEMENTARY:
        hashed.update(np.array(list(map(function, numbers.tolist()))).tobytes())
    hashed.update(np.exp(numbers).tobytes())
    for size in SIZES:
        matrix = np.resize(numbers, (size, size + 1))[:, :size] + np.eye(size)
        product = matrix @ matrix.T
        for made in (
            product,
            matrix @ numbers[:size],
            numbers[:size] @ numbers[-size:],
            np.linalg.inv(matrix),
            np.linalg.cholesky(product),
        ):
            hashed.update(made.tobytes())
    return hashed.hexdigest()[:8]


class XcpAccess(IntEnum):
    """By `meshpoint controller --xcp`."""

    OFF = 0
    READ = 1
    """Measure, and read the settings."""
    WRITE = 2
    """Change settings as well."""


class HeaderError(ValueError):
    """A run header that is missing, torn or of another version; the message says which."""


@dataclass(frozen=True)
class RunHeader:
    """Version, contract, data sheet, settings and calibration of one controller run."""

    version: str
    architecture: str
    dbc_sha256: str
    sheet: GearboxSheet
    settings: ControllerSettings
    calibration: Calibration | None = None
    """What earlier runs have learned; None: a cold start."""
    armed: bool = True
    """Whether valves, clutch and engine may be commanded; False: the controller only listens."""
    xcp: XcpAccess = XcpAccess.OFF
    """What an XCP master may do. Its changes of the settings are frames, and not in here."""
    arithmetic: str | None = None
    """What rounding depends on (`arithmetic`); None: written before it was kept."""

    def canonical(self) -> str:
        """One line of JSON with sorted keys; what is hashed and saved."""
        fields: dict[str, Any] = {
            "version": self.version,
            "architecture": self.architecture,
            "dbc_sha256": self.dbc_sha256,
            "sheet": json.loads(self.sheet.canonical()),
            "settings": self.settings.values(),
            "calibration": self.calibration.to_text() if self.calibration is not None else None,
        }
        file = self.settings.strategy_file
        if file is not None:
            fields["strategy_file"] = {"sha256": file.sha256, "aims": file.aims}
        if not self.armed:
            # Said only where it is so: the header of an armed run is what it always was.
            fields["armed"] = False
        if self.xcp is not XcpAccess.OFF:
            fields["xcp"] = self.xcp.name.lower()
        if self.arithmetic is not None:
            fields["arithmetic"] = self.arithmetic
        return json.dumps(fields, sort_keys=True, separators=(",", ":"))

    @property
    def run_hash(self) -> int:
        """First eight bytes of the SHA-256, low byte first: the status frame's RunHash."""
        digest = hashlib.sha256(self.canonical().encode()).digest()
        return int.from_bytes(digest[:8], "little")

    @property
    def rounds_otherwise(self) -> str:
        """How floating point here may give another last bit than where the run was made; empty
        where nothing known differs. An old header names Python's minor version beside the machine,
        which decides nothing, and not its arithmetic."""
        there = [f"architecture {self.architecture.split(' ')[0]}"]
        here = [f"architecture {platform.machine()}"]
        if self.arithmetic is not None:
            there += self.arithmetic.split(", ")
            here += arithmetic().split(", ")
        theirs, ours = (
            ", ".join(part for part in mine if part not in others)
            for mine, others in ((there, here), (here, there))
        )
        return f"recorded with {theirs}, this is {ours}" if theirs or ours else ""

    def save(self, folder: Path) -> Path:
        """Writes the header into `folder` under the name that `load_header` looks for.

        The file holds exactly what is hashed. OSError where it cannot be written."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / header_name(self.run_hash)
        path.write_text(self.canonical(), encoding="utf-8", newline="")
        return path


def new_header(
    version: str,
    sheet: GearboxSheet,
    settings: ControllerSettings,
    calibration: Calibration | None = None,
    armed: bool = True,
    xcp: XcpAccess = XcpAccess.OFF,
) -> RunHeader:
    """The header of a controller that starts here and now."""
    return RunHeader(
        version, platform.machine(), DBC_SHA256, sheet, settings, calibration, armed, xcp,
        arithmetic(),
    )  # fmt: skip


def run_hash_of(status: ControllerStatus) -> int:
    """The run hash that a status frame carries, in two words."""
    return status.run_hash_high << 32 | status.run_hash_low


def header_name(run_hash: int) -> str:
    """File name of a header."""
    return f"header-{run_hash:016x}.json"


def load_header(folder: Path, run_hash: int) -> RunHeader:
    """The header with this hash from `folder`. HeaderError where it is missing or changed."""
    path = folder / header_name(run_hash)
    try:
        content = read_bounded(path, HEADER_LIMIT_BYTES)
    except UnreadableError as error:
        raise HeaderError(str(error)) from error
    try:
        values = json.loads(content.decode("utf-8"), parse_constant=_no_number)
        header = _from_values(values)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise HeaderError(f"{path}: not a run header of this version: {error}") from error
    if header.run_hash != run_hash:
        raise HeaderError(f"{path}: its content has another hash, {header.run_hash:016x}")
    return header


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number")


def _from_values(values: dict[str, Any]) -> RunHeader:
    sheet, calibration = sheet_from_canonical(values["sheet"]), values["calibration"]
    version, machine, dbc_sha256 = (
        values[name] for name in ("version", "architecture", "dbc_sha256")
    )
    computed = values.get("arithmetic")
    texts = (version, machine, dbc_sha256, calibration or "", computed or "")
    if not all(isinstance(text, str) for text in texts):
        raise TableError("version, architecture, dbc_sha256, calibration and arithmetic are texts")
    return RunHeader(
        version,
        machine,
        dbc_sha256,
        sheet,
        _settings_from(values["settings"], values.get("strategy_file")),
        None if calibration is None else read_calibration(calibration, "calibration", sheet),
        values.get("armed", True),
        XcpAccess[values.get("xcp", XcpAccess.OFF.name).upper()],
        computed,
    )


def _settings_from(values: dict[str, Any], file: dict[str, Any] | None) -> ControllerSettings:
    """Settings in their ranges; `file`: what the header keeps of a user's own strategy."""
    if file is None:
        return read_values(ControllerSettings, values, "settings")
    name = values["strategy_name"]
    if not (isinstance(name, str) and is_file_name(name)):
        raise TableError(f"settings: strategy_name = {name!r}, allowed is {FORM}")
    if not isinstance(file["sha256"], str):
        raise TableError("strategy_file: sha256 is a text")
    known = values | {"strategy_name": ControllerSettings().strategy_name}
    settings = read_values(ControllerSettings, known, "settings")
    own = StrategyFile(name, file["sha256"], bool(file["aims"]))
    return dataclasses.replace(settings, strategy_name=name, strategy_file=own)
