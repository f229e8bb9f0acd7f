"""Records: the same memory for Python and for kernels, also in a copy."""

from __future__ import annotations

import copy
import ctypes
from typing import Annotated, Any

import pytest

from meshpoint.kernels.jit import piece
from meshpoint.kernels.structures import Record, RecordArray, Row, Vector, dtype_of
from meshpoint.rig_sim.truck.layout import Rig


class Wheel(Record):
    teeth: int
    low: Annotated[Row[Annotated[int, ctypes.c_uint16]], 3]


class Turning(Vector):
    speed_rad_s: Annotated[Row[float], 2]
    torque_nm: float


class Machine(Record):
    turning: Turning
    wheels: Annotated[Row[Wheel], 2]


@piece
def run(machine: Machine, h: float) -> float:
    vector = machine.turning.vector
    for i in range(len(vector)):
        vector[i] += h
    for wheel in range(2):
        machine.wheels[wheel].teeth += 1
        machine.wheels[wheel].low[2] = machine.wheels[wheel].teeth & 0xFFFF
    return machine.turning.torque_nm


@piece
def run_all(machines: object, h: float) -> float:
    return run(machines[0], h)  # type: ignore[index]


def test_a_kernel_and_python_see_the_same_fields() -> None:
    machine = Machine()
    machine.turning.speed_rad_s[:] = [1.0, 2.0]
    machine.wheels[1].teeth = 0x1FFFF
    assert run_all(RecordArray(machine).array, 0.5) == 0.5
    assert machine.turning.speed_rad_s[:] == [1.5, 2.5]
    assert machine.turning.vector.tolist() == [1.5, 2.5, 0.5]
    assert [wheel.teeth for wheel in machine.wheels] == [1, 0x20000]
    assert machine.wheels[1].low[:] == [0, 0, 0]
    assert machine.wheels[0].low[:] == [0, 0, 1]


@pytest.mark.parametrize("times", [1, 2])
def test_a_copy_is_one_memory_again_and_leaves_the_other_alone(times: int) -> None:
    memory = RecordArray(Machine())
    held = {"turning": memory.record.turning, "memory": memory, "wheel": memory.record.wheels[1]}
    copied = held
    for _ in range(times):
        copied = copy.deepcopy(copied)
    run_all(copied["memory"].array, 2.0)
    assert copied["turning"].torque_nm == copied["memory"].record.turning.torque_nm == 2.0
    assert copied["wheel"].teeth == 1
    assert memory.record.turning.torque_nm == 0.0
    assert held["wheel"].teeth == 0


def test_a_class_is_asked_for_what_it_declares_not_the_body_that_it_was_made_of() -> None:
    """Python 3.14 keeps annotations out of the body's names (PEP 649); the class has them."""

    class Later(type(Record)):  # type: ignore[misc]
        def __new__(cls, name: str, bases: tuple[type, ...], names: dict[str, Any]) -> Any:
            declared = names.pop("__annotations__")
            kind = super().__new__(cls, name, bases, names)
            kind.__annotations__ = declared
            return kind

    class Sprung(Record, metaclass=Later):
        stiffness_nm_rad: float
        wheel: Wheel

    assert Sprung(2.5).stiffness_nm_rad == 2.5
    assert dtype_of(Sprung).names == ("stiffness_nm_rad", "wheel")
    assert Sprung().wheel.teeth == 0


@pytest.mark.parametrize("name", ["speed", "torque", "__dict__"])
def test_a_field_that_is_not_declared_is_an_error(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(Turning(), name, 1.0)


def test_the_compiler_has_every_field_where_python_has_it() -> None:
    kinds: list[type[Record]] = [Rig, Machine]
    checked = 0
    while kinds:
        kind = kinds.pop()
        dtype = dtype_of(kind)
        assert dtype.itemsize == ctypes.sizeof(kind)  # type: ignore[arg-type]
        for name, field in kind._fields_:  # type: ignore[attr-defined]
            stored, offset = dtype.fields[name][:2]  # type: ignore[index]
            descriptor = getattr(kind, name)
            assert (offset, stored.itemsize) == (descriptor.offset, descriptor.size), name
            checked += 1
            element = getattr(field, "_type_", field)
            if isinstance(element, type) and issubclass(element, Record):
                kinds.append(element)
    assert checked > 100
