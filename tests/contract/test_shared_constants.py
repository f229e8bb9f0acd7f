"""Controller and rig share no number but by the wire contract, the data sheet, or chance.

The rig is written independently of the controller on purpose: a number that both take for granted
would hide what happens where it is wrong. A new one fails here until it is in the data sheet with a
tolerance, learned, derived, or in the list below with a reason.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from fixed_numbers import alike

ROOT: Final = Path(__file__).parents[2]
VALVES: Final = "wire contract: number of a valve in the DBC"
SHARES: Final = "chance: a share without a counterpart in the rig"
COUNT: Final = "chance: a count"
SPAN: Final = "chance: a step of the computation; the rig's is the scatter of a sleeve"
DRAWN: Final = "chance: drag and torque of chance are learned; this is where learning begins"
REASONS: Final = {
    "filters.py: gain_pause": "chance: the brake's gain; the rig's are gains of sensors",
    "filters.py: gain_walk": "chance: the brake's gain; the rig's are gains of sensors",
    "filters.py: drag_pause_nm": DRAWN,
    "filters.py: drag_walk_nm": DRAWN,
    "filters.py: drag_sd_nm": DRAWN,
    "filters.py: torque_disturbance_nm": DRAWN,
    "settings.py: drag_torque_nm": "chance: the guard's bound on drag, no estimate",
    "brake_model.py: OWN_SD": "chance: rates of the pressure's law are learned from every stroke",
    "brake_model.py: EMPTYING": "chance: a knot of a learned law, no rate",
    "brake_model.py: VARIANCE_GROWTH": SHARES,
    "figures.py: GROWTH": SHARES,
    "learned.py: PITCH_SHARE": SHARES,
    "gate.py: AFTER_REJECTED": SHARES,
    "teeth.py: FORGET": SHARES,
    "driveline_swing.py: MOST_SD": SHARES,
    "limits.py: CLUTCH_CLOSED_SHARE": "chance: a position; the rig's is the sine of a threshold",
    "context.py: SEQUENCE_CLUTCH_CLOSED_SHARE": "chance: as CLUTCH_CLOSED_SHARE",
    "learned.py: CALIBRATION_FORMAT": COUNT,
    "stroke.py: SURE": "chance: deviations of a margin; the rig's cut a scatter",
    "stroke.py: PULL_STEP_US": SPAN,
    "stroke.py: ABORT_STEP_US": SPAN,
    "cylinder.py: GAS_J_KGK": "physical: gas constant of air",
    "cylinder.py: AIR_K": "published: 20 degC, at which ISO 6358 states a conductance",
    "cylinder.py: NORMAL_KG_M3": "published: density of air in ISO 6358",
    "cylinder.py: CRITICAL": "published: b of ISO 6358; conductances are learned with it",
    "cylinder.py: LAMINAR": "published: ISO 6358's straight line near no flow",
    "cylinder.py: POLYTROPIC": "published: between 1 and 1.4; conductances are learned with it",
    "lash_cloud.py: FIRST_DRAG": "chance: where learning begins; the rig's is an area",
    "lash.py: LEAST_DRAG": "chance: an acceleration; the rig's is an area",
    "lash_cloud.py: LEAST_SHARE": SHARES,
    "lash.py: SEEN_SDS": "chance: deviations of logarithms; the rig's is a correlation",
    "backlash.py: STEP_S": SPAN,
    "backlash.py: ROWS": COUNT,
    "lash.py: FIRST_EDGES": COUNT,
    "gear_predictor.py: MOST_TICKS": COUNT,
    "step_snapshot.py: engine_torque_step": "wire contract: a per cent, J1939",
    "layshaft.py: gain": "physical: as the data sheet says",
    "reference.py: INDEPENDENT": SHARES,
    "reference.py: BEYOND_SD": "chance: standard deviations; the rig's is a ratio of frictions",
    "reporter.py: _gear": "chance: a gear's number",
    "valve_name.py: SPLIT_LOW": VALVES,
    "driveline.py: SPLITTER": VALVES,
    "limits.py: SPLITTER": VALVES,
    "driveline.py: CLUTCH_ACTION": "wire contract: bits of the clutch command",
    "valve_name.py: SPLIT_HIGH": VALVES,
    "valve_name.py: MAIN_CRAWL": VALVES,
    "valve_name.py: MAIN_THIRD": VALVES,
    "valve_name.py: RANGE_LOW": VALVES,
    "valve_name.py: RANGE_HIGH": VALVES,
    "listening.py: STAMPS": "wire contract: timestamps in an edge frame",
    "inputs.py: STAMPS": "wire contract: timestamps in an edge frame",
    "view.py: READ_CYCLE_US": "wire contract: the sensors are read every 10 ms",
    "listening.py: SAMPLE_S": "wire contract: positions are sampled every millisecond",
    "gearbox_view.py: SAMPLES": "wire contract: samples of a sleeve in a frame",
    "gearbox_view.py: SAMPLE_US": "wire contract: positions are sampled every millisecond",
    "valve_switches.py: LATE_US": "wire contract: the latest a valve's activation may come",
    "valve_switches.py: AHEAD_US": "wire contract: the earliest a valve's activation may come",
    "brake_trajectory.py: CRITICAL": "published: b of ISO 6358; fitting begins there",
    "brake_trajectory.py: LAMINAR_FROM": "numerics: the root of ISO 6358 is a straight line there",
    "brake_figures.py: SENSOR_GAIN_SD": "published: 1 % is the usual class of such sensors",
    "brake_fit.py: CHANCE_RAD2_S3": "chance: the rig's are a drag factor and a correlation",
    "brake_fit.py: ITERATIONS": COUNT,
    "brake_trajectory.py: BY_SPEED": COUNT,
    "cylinder.py: PARAMETERS": COUNT,
    "brake_trajectory.py: LEAST_BINS": COUNT,
    "brake_trajectory.py: SENSOR_LAG": COUNT,
    "brake_trajectory.py: PLATES": COUNT,
    "tooth_fit.py: LEAST_EDGES": COUNT,
    "gearbox_view.py: AHEAD_US": "chance: of the clutch; the rig's is the latest valve activation",
    "gearbox_view.py: LEAST_SAMPLES": COUNT,
    "layshaft.py: SWITCHES_KEPT": COUNT,
    "reference.py: CARRIED": SHARES,
    "driveline_swing.py: LEAST_EDGES": COUNT,
    "limits.py: REACT_US": "chance: a reaction time; the rig's is a deviation of the engine's lag",
    "sleeves.py: REACT_US": "chance: the guard's reaction time, too",
    "sequence.py: SLIP_ROW": "physical: a row's number; the rig's numbers a violation",
    "own_speed.py: MEASURED_US": "chance: a window; the rig's is a deviation of the engine's lag",
    "inputs.py: SPAN_US": "chance: a window; the rig's is a deviation of the engine's lag",
}
"""Names of the controller whose number the rig has too, and why that is no fitting."""


OF_A_STANDARD: Final = {path.name for path in (ROOT / "controller" / "xcp").glob("*.py")}
"""XCP's codes and sizes of packets: no quantity of a gearbox."""


def shared() -> dict[str, tuple[str, float]]:
    """Names of the controller that share a number with the rig, and the rig's name for it."""
    return {
        mine: (theirs, key[1])
        for folder in ("controller", "meshpoint/identify")
        for key, pairs in alike(ROOT / folder, ROOT / "rig_sim").items()
        for mine, theirs in pairs
        if mine.split(":")[0] not in OF_A_STANDARD
    }


def test_controller_and_rig_share_no_number_without_a_reason() -> None:
    new = {name: other for name, other in shared().items() if name not in REASONS}
    assert not new, "data sheet with a tolerance, learned, derived, or a reason here"


def test_every_reason_is_still_needed() -> None:
    assert set(REASONS) == set(shared())
