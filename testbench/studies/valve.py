"""Figure 6.1: brake pressure, the model against the real system."""

from __future__ import annotations

import numpy as np

from testbench.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Style,
    Table,
    Verdict,
    rms,
)
from testbench.studies.validation import BAR, Settings, pressures, traces, truck_run


def _conclude(given: Given[Settings]) -> Finding:
    compared = [pressures(given.sheet, trace) for trace in traces(given)]
    errors = np.concatenate([each.error for each in compared])
    supply_bar = given.sheet.air.supply_gauge_pa / BAR
    deviation, worst = rms(errors), float(np.abs(errors).max())
    share = deviation / supply_bar
    limit = given.own.slight_share
    statement = Statement(
        "the modelled pressure follows the measured one with slight variations during build-up "
        "and decrease",
        f"RMS deviation {deviation:.2f} bar = {100 * share:.1f} % of the supply's {supply_bar:g} "
        f"bar, at most {worst:.2f} bar, over {len(compared)} shifts",
        Verdict.AGREES if share <= limit else Verdict.DIFFERS,
        f"slight is taken as RMS <= {100 * limit:g} % of supply. The measured valve is the truck "
        "rig's: ISO 6358 flow, choked and then a tail, where the model is of first order; supply, "
        "delay and conductance are drawn from their tolerances",
    )
    shown = compared[0]
    chart = Chart(
        "valve",
        "Pressure between valve and brake during an upshift",
        "ms since the main box came free",
        (
            Panel(
                "bar absolute",
                (
                    Line("measured (truck rig)", shown.time_ms, shown.measured, Style.JOINED),
                    Line("model (4.1)", shown.time_ms, shown.model),
                ),
            ),
            Panel("model - measured, bar", (Line("deviation", shown.time_ms, shown.error),)),
        ),
    )
    rows = tuple(
        (i + 1, rms(each.error), float(np.abs(each.error).max())) for i, each in enumerate(compared)
    )
    table = Table("shifts", "Deviation by shift", ("shift", "RMS, bar", "most, bar"), rows)
    values = {
        "rms_bar": deviation,
        "rms_percent_of_supply": 100.0 * share,
        "most_bar": worst,
        "shifts": len(compared),
    }
    return Finding((statement,), values, (chart,), (table,))


STUDY = Study("valve", "Brake valve and pressure", ("figure 6.1",), Settings, _conclude, truck_run)
