"""`Log`: what was recorded on a bus, as Arrow tables and as shifts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args, get_type_hints

from meshpoint.api.choices import PathLike, load_gearbox
from meshpoint.bus.logs.files import log_files, read_logs
from meshpoint.controller.settings.header import HeaderError, RunHeader, load_header, run_hash_of
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.fields import FieldKind, FieldSpec
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import ControllerStatus, Message
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import TableError
from meshpoint.replays.replay import LogReplay
from meshpoint.report.beliefs import Beliefs
from meshpoint.report.collect import ReportCollector
from meshpoint.report.run import Report, ReportRun
from meshpoint.report.write import report_provenance, write_report
from meshpoint.results.monitor import RowMonitor
from meshpoint.results.rows import ShiftRow
from meshpoint.results.shift_parts import PARTS

if TYPE_CHECKING:
    import pyarrow as pa

NAMES: Final = {codec.spec.can_id: name for name, codec in CODECS.items()}


def load_arrow() -> Any:
    """pyarrow, loaded where a table is asked for."""
    try:
        import pyarrow as pa
    except ImportError as error:
        raise ImportError("Arrow tables need pyarrow: pip install pyarrow") from error
    return pa


class Log:
    """A recorded bus: `.log` (candump), `.blf`, `.asc`, `.trc`, `.csv` or `.mf4`, each also `.gz`;
    several files in order, or a folder of logs, are one bus.

    bus: of a log of several buses, the one that is wanted: `can0`, or its number.
    header_dir: where the run headers are; without it, beside the log.

    Reading raises LogError, which names file, place and what is wrong there; damage ends a log, the
    frames before it are given first.
    """

    def __init__(
        self, *paths: PathLike, bus: str | None = None, header_dir: PathLike | None = None
    ) -> None:
        self.files = log_files(Path(path) for path in paths)
        self._bus = bus
        self._headers = Path(header_dir) if header_dir is not None else self.files[0].parent

    def __iter__(self) -> Iterator[tuple[float, Frame]]:
        """Times in s and frames, in order, read anew each time."""
        return read_logs(self.files, self._bus)

    def counts(self) -> Counter[str]:
        """How many frames of each message of the DBC; all others as `(foreign)`."""
        return Counter(NAMES.get(frame.can_id, "(foreign)") for _, frame in self)

    def frames(self) -> pa.Table:
        """Every frame: time_s, can_id, message (its name in the DBC), is_fd, is_extended, data."""
        pa, rows = load_arrow(), list(self)
        return pa.table(
            {
                "time_s": pa.array([time_s for time_s, _ in rows], pa.float64()),
                "can_id": pa.array([f.can_id for _, f in rows], pa.uint32()),
                "message": pa.array(
                    [NAMES.get(f.can_id) for _, f in rows], pa.string()
                ).dictionary_encode(),
                "is_fd": pa.array([f.is_fd for _, f in rows], pa.bool_()),
                "is_extended": pa.array([f.is_extended for _, f in rows], pa.bool_()),
                "data": pa.array([f.data for _, f in rows], pa.binary()),
            }
        )

    def messages(self, kind: type[Message] | str) -> pa.Table:
        """Every message of a type: time_s of the log, and a column for each field.

        kind: a class of `meshpoint.messages`, or its name. Values are SI, the unit ends the field's
        name; an enumeration's are their names; a row of equal signals is a list. Frames with a
        wrong length or CRC, or a value outside the DBC's range, are left out. KeyError for a name
        that the DBC does not have.
        """
        name = kind if isinstance(kind, str) else kind.__name__
        if name not in CODECS:
            raise KeyError(f"{name}: no message of the DBC; `meshpoint show messages` lists them")
        codec, times_s, found = CODECS[name], [], []
        for time_s, frame in self:
            message = read_alone(codec, frame)
            if message is not None:
                times_s.append(time_s)
                found.append(message)
        pa = load_arrow()
        columns = {"time_s": pa.array(times_s, pa.float64())}
        for field in codec.fields:
            values = [getattr(message, field.name) for message in found]
            columns[field.name] = _column(pa, field, values)
        return pa.table(columns)

    @cached_property
    def header(self) -> RunHeader:
        """The run header of the first controller in the log: its data sheet and settings.
        HeaderError where there is none."""
        codec = CODECS[ControllerStatus.__name__]
        for _, frame in self:
            status = read_alone(codec, frame)
            if status is not None:
                return load_header(self._headers, run_hash_of(status))
        raise HeaderError(f"{self.files[0]}: holds no controller status frame")

    def shifts(self, gearbox: PathLike | GearboxSheet | None = None) -> list[ShiftRow]:
        """Every shift: what the controller reported beside the rig's truth, where that is recorded.

        gearbox: the data sheet, where the log has no run header beside it."""
        sheet, settings = self._sheet(gearbox)
        monitor = RowMonitor(sheet, settings)
        for _, frame in self:
            monitor.take(frame)
        return monitor.rows.rows

    def report(
        self,
        path: PathLike,
        title: str | None = None,
        gearbox: PathLike | GearboxSheet | None = None,
    ) -> Path:
        """Writes a page with every shift's traces (HTML, offline), and returns where. gearbox: as
        in `shifts`. Where the run header is there, the controller is repeated to say why a shift
        missed its gap, which takes about as long as `meshpoint replay`."""
        sheet, settings = self._sheet(gearbox)
        beliefs = Beliefs()
        if gearbox is None:
            replay = LogReplay(self._headers, verify=False, on_step=beliefs.look)
            replay.run(frame for _, frame in self)
        collector = ReportCollector(
            sheet, settings.aim.target_rad(sheet.dog.backlash_rad), settings, beliefs
        )
        for _, frame in self:
            collector.receive(frame)
        report = Report(
            title=title or f"meshpoint: {self.files[0].name}",
            subtitle="A recorded bus.",
            sheet=sheet,
            runs=[ReportRun(settings.strategy_name, collector.finish())],
            provenance=report_provenance(sheet, log=", ".join(file.name for file in self.files)),
        )
        write_report(Path(path), report)
        return Path(path)

    def _sheet(
        self, gearbox: PathLike | GearboxSheet | None
    ) -> tuple[GearboxSheet, ControllerSettings]:
        if gearbox is not None:
            return load_gearbox(gearbox), ControllerSettings()
        try:
            return self.header.sheet, self.header.settings
        except HeaderError as error:
            raise TableError(f"{error}; gearbox= names the data sheet") from error


def _column(pa: Any, field: FieldSpec, values: list[Any]) -> Any:
    kinds = {
        FieldKind.BOOL: pa.bool_(),
        FieldKind.ENUM: pa.string(),
        FieldKind.INT: pa.uint64() if field.signals[0].raw_max > 2**63 else pa.int64(),
        FieldKind.FLOAT: pa.float64(),
    }
    kind = kinds[field.kind]
    if field.is_tuple:
        return pa.array([list(row) for row in values], pa.list_(kind))
    if field.kind is FieldKind.ENUM:
        return pa.array([value.name for value in values], kind).dictionary_encode()
    return pa.array(values, kind)


def shifts_table(rows: Iterable[ShiftRow]) -> pa.Table:
    """Shifts as a table: a column for each field of `ShiftRow`, and one for each of its parts.

    A column's type is the same for all shifts, also where none has a value or there is none."""
    records = []
    for row in rows:
        record = row.to_json()
        record |= record.pop("phases")
        records.append(record)
    pa = load_arrow()
    return pa.Table.from_pylist(records, schema=_shift_schema(pa))


def _shift_schema(pa: Any) -> pa.Schema:
    """The columns of `ShiftRow.to_json`, its parts (`phases`) behind the others."""
    kinds = {str: pa.string(), bool: pa.bool_(), int: pa.int64(), float: pa.float64()}
    columns = {
        name.rstrip("_"): next(kind for plain, kind in kinds.items() if plain in _plain(given))
        for name, given in get_type_hints(ShiftRow).items()
        if name != "phases"
    }
    columns |= dict.fromkeys(("phase_error_pct_of_pitch", *PARTS), pa.float64())
    return pa.schema(columns)


def _plain(given: Any) -> tuple[Any, ...]:
    """The types of `X`, or of `X | None`."""
    return get_args(given) or (given,)
