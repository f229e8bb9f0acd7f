"""Figure 6.2: the brake's torque after a step at the valve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    ThesisVerdict,
)
from meshpoint.controller.models.thesis import layshaft_model, propagate
from meshpoint.gearbox import Split
from meshpoint.gearbox.tables import count, quantity

THESIS_NM = 100.0


@dataclass(frozen=True)
class Settings:
    """How long the step is looked at, and how near the end value must come."""

    until_ms: int = count("until_ms", 50, 10000)
    tolerance_share: float = quantity("tolerance_percent", 0.0, 50.0, 0.01)


def _conclude(given: Given[Settings]) -> Finding:
    sheet, own = given.sheet, given.own
    model = layshaft_model(sheet, Split.HIGH)
    delay_us = sheet.brake.valve_delay_s * 1e6
    switches = np.array([[delay_us], [1.0]])
    times_ms = np.arange(0.0, own.until_ms + 0.5, 0.5)
    torque = np.empty_like(times_ms)
    for i, time_ms in enumerate(times_ms.tolist()):
        # at rest, as in the thesis: the torque depends on the pressure alone
        x = np.zeros(3)
        propagate(x, 0.0, 1000.0 * time_ms, switches, model)
        torque[i] = -sheet.brake_nm_per_pa * x[2]
    most_nm = float(-torque.min())
    rise_ms = float(times_ms[np.argmax(-torque >= 0.632 * THESIS_NM)])
    first_ms = float(times_ms[np.argmax(torque < 0.0)])
    near = abs(most_nm - THESIS_NM) <= own.tolerance_share * THESIS_NM
    statement = Statement(
        f"a step at the valve gives {THESIS_NM:.0f} Nm at the supply's full pressure, after the "
        "valve's delay",
        f"{most_nm:.2f} Nm after {own.until_ms} ms; first reaction after {first_ms:.1f} ms",
        ThesisVerdict.BY_CONSTRUCTION if near else ThesisVerdict.DIFFERS,
        f"C_db = T_max / p_max (4.4) makes the end value the sheet's {sheet.brake.max_torque_nm:g} "
        "Nm, which are the thesis's; delay and time constant are the sheet's, the thesis gives "
        "neither",
    )
    chart = Chart(
        "torque",
        "Brake torque after a step at t = 0",
        "ms since the step",
        (
            Panel(
                "torque on the layshaft, Nm",
                (Line("model (4.1, 4.3)", times_ms, torque),),
                levels={"thesis: specified maximum": -THESIS_NM},
            ),
        ),
    )
    values = {"torque_nm": most_nm, "first_reaction_ms": first_ms, "to_63_percent_ms": rise_ms}
    return Finding((statement,), values, (chart,))


STUDY = Study("torque", "Torque of the layshaft brake", ("figure 6.2",), Settings, _conclude)
