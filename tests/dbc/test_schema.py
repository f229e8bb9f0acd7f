"""What is refused of a DBC, and what the product's own says."""

import contextlib
import hashlib
import shutil
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.dbc import DBC_PATH, DBC_SHA256, Node
from meshpoint.dbc.edges import EDGE_IDS
from meshpoint.dbc.schema import OWN, SCHEMA, SchemaError, main, parse_schema, schema_of
from meshpoint.dbc.specs import Schema

SMALL = """VERSION "1.0"
NS_ :
BS_:
BU_: GearboxIo Engine Reference TransmissionControl Bench
VAL_TABLE_ ValveAction 1 "OnNow" 0 "OffNow" ;
BO_ 2566856832 First: 16 GearboxIo
 SG_ Crc : 0|16@1+ (1,0) [0|65535] "" Bench
 SG_ Counter : 16|8@1+ (1,0) [0|255] "" Bench
 SG_ Pressure : 24|16@1+ (0.0002,0) [0|13.107] "bar" Bench
 SG_ Action : 40|8@1+ (1,0) [0|1] "" Bench

BO_ 2364539904 Second: 8 Engine
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" TransmissionControl

BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN_FD","J1939PG";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgSendType" ENUM "Cyclic","Event";
BA_DEF_ BO_ "E2EProfile" ENUM "None","P05","P99";
BA_DEF_ BO_ "E2EDataId" HEX 0 65535;
BA_DEF_ SG_ "GenSigStartValue" FLOAT -1E+20 1E+20;
BA_DEF_ SG_ "ValueTable" STRING ;
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_DEF_DEF_ "GenMsgCycleTime" 10;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_DEF_DEF_ "E2EProfile" "None";
BA_DEF_DEF_ "E2EDataId" 0;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_DEF_DEF_ "ValueTable" "";
BA_ "VFrameFormat" BO_ 2566856832 1;
BA_ "E2EProfile" BO_ 2566856832 1;
BA_ "E2EDataId" BO_ 2566856832 77;
BA_ "ValueTable" SG_ 2566856832 Action "ValveAction";
BA_ "GenSigStartValue" SG_ 2566856832 Pressure 5000;
VAL_ 2566856832 Action 1 "OnNow" 0 "OffNow" ;
"""
THIRD = """BO_ 2364539904 Third: 8 Engine
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" TransmissionControl
"""


def parsed(text: str) -> Schema:
    return parse_schema(text.encode("cp1252"), "small.dbc")


def test_a_small_dbc_is_read() -> None:
    first, second = parsed(SMALL).messages
    assert (first.name, first.can_id, first.length, first.is_fd) == ("First", 0x18FF2080, 16, True)
    assert (first.sender, first.receivers) == (Node.GEARBOX_IO, {Node.BENCH})
    assert (first.cycle_time_us, first.data_id) == (10_000, 77)
    pressure, action = first.signals[2:]
    assert (pressure.raw_min, pressure.raw_max, pressure.raw_start) == (0, 65535, 5000)
    assert action.value_table == "ValveAction"
    assert (second.is_fd, second.is_protected) == (False, False)
    assert second.signals[0].raw_max == 64255


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("First: 16", "First: 1000000", "message First: length is 1000000, 0..64"),
        ("First: 16", "First: 65", "message First: length is 65, 0..64"),
        ("First: 16", "First: 17", "message First: .*length of"),
        ("Second: 8", "Second: 16", "message Second: .*length of"),
        ("24|16@1+ (0.0002", "24|99999999@1+ (0.0002", "signal Pressure: size is 99999999, 1..64"),
        ("24|16@1+ (0.0002", "999|16@1+ (0.0002", "signal Pressure: start bit is 999, 0..511"),
        ("24|16@1+ (0.0002", "120|16@1+ (0.0002", "signal Pressure ends at bit 136, 128"),
        ("24|16@1+ (0.0002", "24|17@1+ (0.0002", "signals Pressure and Action overlap"),
        ("(0.0002,0)", "(0,0)", "signal Pressure: scale is 0, other than 0"),
        ("(0.0002,0)", "(1e400,0)", "signal Pressure: .* 1e400, a finite number"),
        ("(0.0002,0)", "(0.0002,nan)", "signal Pressure: .* nan, a finite number"),
        ("[0|13.107]", "[0|1e999]", "signal Pressure: .* 1e999, a finite number"),
        ("[0|13.107]", "[13|13]", "signal Pressure: range 13..13 holds no two values"),
        ("24|16@1+ (0.0002", "31|16@0+ (0.0002", "signal Pressure: little-endian"),
        ("Pressure : 24|", "Pressure m0 : 24|", "'SG_ Pressure m0 :' is multiplexed"),
        ("BA_DEF_ SG_", "SG_MUL_VAL_ 1 A B 0-9999999999;\nBA_DEF_ SG_", "SG_MUL_VAL_ 1' is multi"),
        ('"bar"', '"psi"', "signal Pressure: unit 'psi'"),
        ("Pressure", "pressure", "name 'pressure'"),
        (" Pressure", " Class", "name 'Class'"),
        (" Pressure :", " Counter :", "signal counter is there twice"),
        ("Second:", "First:", "message or value table First is there twice"),
        ("Second:", "ValveAction:", "message or value table ValveAction is there twice"),
        ('BA_DEF_ BO_ "V', f'{THIRD}BA_DEF_ BO_ "V', "identifier 0x0CF00400 is there twice"),
        ("BO_ 2364539904", "BO_ 100", "message Second: 29-bit identifier"),
        ("SG_ Crc : 0|16", "SG_ Crc : 0|8", "message First: starts with"),
        ("16 GearboxIo", "16 Nobody", r"message First: sender \['Nobody'\]"),
        ('"bar" Bench', '"bar" Engine', "message First: its signals have receivers"),
        ("BO_ 2566856832 77", "BO_ 2566856832 65536", "E2EDataId 65536, 0..65535"),
        ('E2EProfile" BO_ 2566856832 1', 'E2EProfile" BO_ 2566856832 2', "E2EProfile P99"),
        ('VFrameFormat" BO_ 2566856832 1', 'VFrameFormat" BO_ 2566856832 0', "StandardCAN"),
        ('"GenMsgCycleTime" 10', '"GenMsgCycleTime" 0', "GenMsgCycleTime 0, more than 0"),
        ('BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;', "", "GenMsgCycleTime is not defined"),
        ("Pressure 5000", "Pressure 65536", "GenSigStartValue 65536, 0..65535"),
        ("Pressure 5000", "Pressure 0.5", "GenSigStartValue 0.5, a whole raw value"),
        ('2 Action 1 "OnNow"', '2 Action 1 "OnSoon"', "signal Action: VAL_ .* is not the table"),
        ('Action "ValveAction"', 'Action "Missing"', "signal Action: VAL_ .* is not the table"),
        ("40|8@1+ (1,0) [0|1]", "40|8@1+ (1,0) [0|9]", "signal Action: range 0..9 is not that"),
        (
            'VAL_TABLE_ ValveAction 1 "OnNow"',
            'VAL_TABLE_ ValveAction 2 "OnNow"',
            r"values \[0, 2\]",
        ),
        ('1 "OnNow"', '1 "import os"', "words like OnAt"),
        (SMALL, "", "0 messages, 1..1000"),
        (SMALL, "these are no messages", "0 messages"),
        ("NS_ :", 'NS_ : "', 'a text begins with " and never ends'),
        ("NS_ :", "NS :", "not a DBC file"),
        ("SG_ Pressure : 24|16@1+", "SG_ Pressure : twenty@1+", "a signal is not start"),
    ],
)
def test_a_hostile_or_broken_dbc_is_refused_by_name(old: str, new: str, complaint: str) -> None:
    assert old in SMALL
    with pytest.raises(SchemaError, match=complaint) as refusal:
        parsed(SMALL.replace(old, new))
    assert str(refusal.value).startswith("small.dbc: ")


def test_the_data_id_is_used_once() -> None:
    again = SMALL.replace("Second: 8 Engine", "Second: 16 Engine").replace(
        "2364539904", "2566856833"
    )
    twice = again.replace(
        "SG_ EngineSpeed",
        'SG_ Crc : 0|16@1+ (1,0) [0|65535] "" '
        'TransmissionControl\n SG_ Counter : 16|8@1+ (1,0) [0|255] "" '
        "TransmissionControl\n SG_ EngineSpeed",
    )
    twice += "".join(
        f'BA_ "{name}" BO_ 2566856833 {value};\n'
        for name, value in [("VFrameFormat", 1), ("E2EProfile", 1), ("E2EDataId", 77)]
    )
    with pytest.raises(SchemaError, match="E2EDataId 77 is there twice"):
        parsed(twice)


@pytest.mark.parametrize(
    "hostile",
    [
        pytest.param(SMALL + "\n" * 1_000_000, id="too large"),
        pytest.param(SMALL + 'CM_ "' + '\\"' * 150_000, id="text without end"),
        pytest.param(SMALL + " SG_ A : 0|1@" + "x" * 300_000, id="signal without end"),
        pytest.param(SMALL + "BO_ 1 A: 8 Bench\n" * 15_000, id="too many messages"),
        pytest.param(SMALL.replace("16@1+ (0.0002", "9" * 300_000 + "@1+ (0.0002"), id="digits"),
    ],
)
def test_no_text_keeps_the_reader_busy(hostile: str) -> None:
    """Refusing it takes no longer than reading some copies of the product's own DBC, which is a
    seventh to a half of its size; going back and forth in it would take hours."""

    def processor_s(content: bytes) -> float:
        start_s = time.process_time()
        with contextlib.suppress(SchemaError):
            parse_schema(content, "some.dbc")
        return time.process_time() - start_s

    with pytest.raises(SchemaError):
        parsed(hostile)
    assert processor_s(hostile.encode("cp1252")) < 20.0 * processor_s(DBC_PATH.read_bytes())


LINES = SMALL.splitlines(keepends=True)


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(
            st.integers(0, len(SMALL) - 1),
            st.integers(0, 12),
            st.one_of(st.text(max_size=4), st.sampled_from([*LINES, "0", "-1", "1e400", '"', ";"])),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_a_mangled_dbc_is_read_or_refused_but_never_crashes(
    edits: list[tuple[int, int, str]],
) -> None:
    text = SMALL
    for where, cut, inserted in edits:
        text = text[:where] + inserted + text[where + cut :]
    try:
        parse_schema(text.encode("utf-8"), "mangled.dbc")
    except SchemaError as refusal:
        assert str(refusal).startswith("mangled.dbc: ")


def test_the_hash_is_that_of_the_file() -> None:
    assert hashlib.sha256(DBC_PATH.read_bytes()).hexdigest() == DBC_SHA256


def test_source_addresses_are_those_of_the_senders() -> None:
    addresses = {
        Node.GEARBOX_IO: 0x80,
        Node.ENGINE: 0x00,
        Node.REFERENCE: 0x81,
        Node.TRANSMISSION_CONTROL: 0x03,
        Node.BENCH: 0xF9,
    }
    for message in SCHEMA.messages:
        assert message.can_id & 0xFF == addresses[message.sender]


def test_own_messages_are_protected_fd_and_standard_ones_classic() -> None:
    """Proprietary B of J1939 is PGN 0xFF00..0xFFFF."""
    for message in SCHEMA.messages:
        is_proprietary = message.can_id >> 16 & 0xFF == 0xFF
        assert message.is_fd == message.is_protected == is_proprietary
    names = {message.name for message in SCHEMA.messages if not message.is_fd}
    assert names == {"EEC1", "TSC1", "ETC1", "ETC2", "TC1"}


def test_valves_outrank_edges_on_the_bus() -> None:
    identifiers = {message.name: message.can_id for message in SCHEMA.messages}
    assert max(identifiers["ValveCommand"], identifiers["ClutchCommand"]) < min(EDGE_IDS)


def test_what_is_written_beside_the_own_dbc_files_is_what_they_say() -> None:
    assert main(["--check"]) == 0
    for path in OWN:
        assert schema_of(path) == parse_schema(path.read_bytes(), path.name)


def test_a_dbc_that_was_changed_since_is_read_itself(tmp_path: Path) -> None:
    path = tmp_path / "small.dbc"
    path.write_bytes(SMALL.encode())
    alone = schema_of(path)
    shutil.copy(DBC_PATH.with_suffix(".json"), path.with_suffix(".json"))
    assert schema_of(path) == alone == parse_schema(SMALL.encode(), path.name)
