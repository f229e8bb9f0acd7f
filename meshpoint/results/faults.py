"""What a shift's fault code means, and what to do: one line each, for people at a bench."""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.messages import FaultCode

STALE_FAULTS: Final = frozenset(
    {FaultCode.SPEED_STALE, FaultCode.POSITION_STALE, FaultCode.VALVE_LINK_LOST}
)
"""What the controller finds when the other node's frames stay away or come late. A request that
ends so may be asked again: nothing is broken."""
LATE_ADVICE: Final = (
    "a node was late or is not there: free the machine, or let bus time wait for both nodes "
    "(`meshpoint up --pace-only FILE`, and `--pace FILE` for rig and controller)"
)
MEANING: Final[dict[FaultCode, str]] = {
    FaultCode.NONE: "no fault",
    FaultCode.SPEED_STALE: "no fresh edges of layshaft or main shaft",
    FaultCode.POSITION_STALE: "no fresh sleeve positions",
    FaultCode.VALVE_LINK_LOST: "no fresh valve status",
    FaultCode.CLUTCH_STUCK: "the clutch did not open or close in time: see its position and air",
    FaultCode.DISENGAGE_FAILED: "the old gear did not come out in time: torque in the mesh, or air",
    FaultCode.SYNCHRONISE_FAILED: "the speeds did not come together in time: brake, or engine; or "
    "somebody else brought the box into a gear meanwhile",
    FaultCode.ENGAGE_FAILED: "the sleeve did not go in, in all the attempts that are allowed",
    FaultCode.GUARD_BLOCKED: "the guard blocked the valve commands; the controller's own lines "
    "name the row (docs/guard.md). Frames that come late are one cause",
    FaultCode.REQUEST_IMPOSSIBLE: "no such gear, or a sleeve stands between two gears",
    FaultCode.LOW_SUPPLY: "too little air: wait until the supply is up",
    FaultCode.INPUT_OVERSPEED: "the input shaft would turn too fast in that gear: slow down first",
    FaultCode.DISENGAGE_REFUSED: "a sleeve stays in while there is torque: open the clutch",
    FaultCode.BRAKE_LIMIT: "the layshaft brake was on for as long, or as hot, as it may be",
    FaultCode.SPLITTER_FAILED: "the splitter did not move in time",
    FaultCode.RANGE_FAILED: "the range did not move in time",
    FaultCode.ENGINE_FAILED: "the engine did not come to the speed it was asked for",
    FaultCode.INPUT_WHEEL_WRONG: "the input shaft's speed sensor contradicts the layshaft's: see "
    "its wheel and the tooth count of the data sheet",
    FaultCode.LAYSHAFT_WHEEL_WRONG: "the layshaft's speed sensor contradicts the others: see its "
    "wheel and the tooth count of the data sheet",
    FaultCode.MAIN_WHEEL_WRONG: "the main shaft's speed sensor contradicts the others: see its "
    "wheel and the tooth count of the data sheet",
    FaultCode.PROPELLER_WHEEL_WRONG: "the propeller shaft's speed sensor contradicts the main "
    "shaft's: see its wheel and the tooth count of the data sheet",
    FaultCode.WHEELS_DISAGREE: "two speed sensors contradict each other, and no third says which "
    "is wrong: the controller's own lines name both",
    FaultCode.SLIP_AT_CONTACT: "a sleeve came to a gear that turned against it outside the guard's "
    "slip window, as one thrown through neutral: look at the dog teeth",
}


def explain(fault: FaultCode) -> str:
    """The code's name, what it means and, where a node was late, what to do."""
    line = f"{fault.name.lower()}: {MEANING[fault]}"
    return f"{line}; {LATE_ADVICE}" if fault in STALE_FAULTS else line
