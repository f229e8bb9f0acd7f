"""Figure 6.3: layshaft speed, the model against the real system."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Table,
    ThesisVerdict,
    rms,
)
from benchmarks.studies.validation import (
    Settings,
    pressures,
    speeds,
    time_constant_s,
    traces,
    truck_run,
)


def _conclude(given: Given[Settings]) -> Finding:
    shifts, sheet = traces(given), given.sheet
    tau_s = time_constant_s(sheet, pressures(sheet, shifts[0]))
    fitted = replace(sheet, brake=replace(sheet.brake, time_constant_s=tau_s))
    compared = [speeds(fitted, trace) for trace in shifts]
    by_sheet = np.concatenate([speeds(sheet, trace).error for trace in shifts])
    errors = np.concatenate([each.error for each in compared])
    deviation, worst = rms(errors), float(np.abs(errors).max())
    taken = float(np.mean([each.measured[0] - each.measured[-1] for each in compared]))
    share, limit = deviation / taken, given.own.slight_share
    at_end = float(np.mean([each.error[-1] for each in compared]))
    statement = Statement(
        "the model follows the real system's layshaft speed as well as expected until the gear "
        "engages",
        f"RMS deviation {deviation:.1f} rpm = {100 * share:.1f} % of the {taken:.0f} rpm taken "
        f"away; {at_end:+.1f} rpm on average at contact, at most {worst:.1f} rpm, over "
        f"{len(compared)} shifts; with the sheet's tau {rms(by_sheet):.1f} rpm",
        ThesisVerdict.AGREES if share <= limit else ThesisVerdict.DIFFERS,
        f"well is taken as RMS <= {100 * limit:g} % of the speed taken away (the thesis gives a "
        "picture, no figure). tau is from the "
        "valve's step response, as in study valve; the truck rig's inertia, brake torque, its "
        "fade, air and drag "
        "deviate from the sheet by their tolerances; an error of the brake's torque adds up as "
        "long as it brakes",
    )
    shown = compared[0]
    chart = Chart(
        "layshaft",
        "Layshaft speed during an upshift",
        "ms since the main box came free",
        (
            Panel(
                "rpm",
                (
                    Line("measured (truck rig)", shown.time_ms, shown.measured),
                    Line("model (4.13)", shown.time_ms, shown.model),
                ),
            ),
            Panel(
                "model - measured, rpm",
                tuple(
                    Line(f"shift {i + 1}", each.time_ms, each.error)
                    for i, each in enumerate(compared)
                ),
            ),
        ),
    )
    rows = tuple(
        (i + 1, rms(each.error), float(each.error[-1]), float(each.measured[0] - each.measured[-1]))
        for i, each in enumerate(compared)
    )
    columns = ("shift", "RMS, rpm", "at contact, rpm", "taken away, rpm")
    table = Table("shifts", "Deviation by shift", columns, rows)
    values = {
        "rms_rpm": deviation,
        "rms_rpm_with_sheet_tau": rms(by_sheet),
        "rms_percent_of_speed_taken_away": 100.0 * share,
        "mean_at_contact_rpm": at_end,
        "most_rpm": worst,
        "shifts": len(compared),
    }
    return Finding((statement,), values, (chart,), (table,))


STUDY = Study("layshaft", "Layshaft speed", ("figure 6.3",), Settings, _conclude, truck_run)
