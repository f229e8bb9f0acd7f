"""The message classes and their stub."""

import ast
import pickle
from enum import IntEnum

import meshpoint.dbc.messages
from meshpoint.dbc.layout import main as print_source
from meshpoint.dbc.messages import MESSAGE_TYPES, TSC1, MainGear, TscOverrideMode, ValveCommand
from meshpoint.dbc.stubs import STUB_PATH, make_stub
from meshpoint.dbc.stubs import main as write_stub


def stub_fields() -> dict[str, list[str]]:
    """The classes of the stub with the names of their fields or members."""
    classes = [n for n in ast.parse(STUB_PATH.read_text()).body if isinstance(n, ast.ClassDef)]
    return {
        node.name: [
            ast.unparse(item.target if isinstance(item, ast.AnnAssign) else item.targets[0])
            for item in node.body
            if isinstance(item, ast.AnnAssign | ast.Assign)
        ]
        for node in classes
    }


def test_the_stub_is_in_step_with_the_dbc() -> None:
    assert STUB_PATH.read_text(encoding="utf-8") == make_stub()
    assert write_stub(["--check"]) == 0


def test_the_stub_tells_what_there_is_at_run_time() -> None:
    for name, fields in stub_fields().items():
        made = getattr(meshpoint.dbc.messages, name)
        members = list(made.__members__) if issubclass(made, IntEnum) else list(made._fields)
        assert members == fields
    assert set(MESSAGE_TYPES) <= set(stub_fields())


def test_messages_and_enumerations_survive_pickling() -> None:
    values = (ValveCommand(), MainGear.THIRD)
    assert pickle.loads(pickle.dumps(values)) == values


def test_a_default_tsc1_leaves_the_engine_alone() -> None:
    assert TSC1().override_control_mode is TscOverrideMode.OVERRIDE_DISABLED


def test_the_generated_source_can_be_read(capsys) -> None:
    assert print_source(["GearboxSensors"]) == 0
    compile(capsys.readouterr().out, "printed", "exec")
    assert print_source(["Nonsense"]) == 2
