"""What the keys of `--json` say, for docs/reference/json.md; tests hold that none is missing."""

from __future__ import annotations

from typing import Final

JUDGED_KEYS: Final = {
    "from": "The gear before.",
    "to": "The gear asked for.",
    "request_us": "Time of the request, by the sensor clock's 32 bits.",
    "strategy": "The strategy that acts: `speed_window` stands in while the reference is unknown.",
    "reference": "Whether the gear's phase reference is known.",
    "status": "`fired`; `planned`: a firing was sent and could still be moved; `waiting`; "
    "`refused`; `ended`: it gave up before it fired; `not judged`: the recorded controller could "
    "not be repeated up to here.",
    "fault": "Its fault code.",
    "release_ms": "Activation of brake off, by its last decision, since the request.",
    "fired_ms": "Activation of the sleeve's valve, by its last decision, since the request.",
    "expected_contact_ms": "When it expects that firing to meet its gear.",
    "predicted_phase_deg": "The phase expected there; null without a reference.",
    "predicted_phase_sd_deg": "Its standard deviation.",
    "predicted_slip_rpm": "The slip expected there.",
    "decided_ms": "When it decided so.",
    "on_own_trajectory": "Whether on frames that answer to its own commands.",
    "last_on_own_trajectory": "Its last decision that was, with the same keys; null: none.",
    "parted": "`at_ms`, `commands` (valves, `clutch`, `engine`), and what each had decided there, "
    "`recorded` and `replayed`; null: it commands what was recorded.",
    "trajectory_parted_ms": "When a valve is first driven, or clutch or engine commanded, "
    "otherwise; null: never.",
    "judged_to_ms": "When the recorded sleeve was expected at its gear; no later decision counts.",
    "aborted_ms": "When it stopped a sleeve on its way, on frames that answer to its own commands; "
    "an aborted firing is none of the above.",
    "contact": "Always null: where its tooth would have met is not in the log.",
    "contact_why": "The reason.",
    "counterfactual": "Where its tooth would have landed, worked out.",
    "strayed_at_step": "From this step on the recorded controller is not repeated exactly, as "
    "another version made the log; else null.",
    "events": "What it says of its decisions.",
    "recorded": "The log's row as `simulate --json` has it, with `release_ms` and `fired_ms` of "
    "the recorded firing that was not aborted.",
}
"""A row of `shifts` of `replay --strategy`."""

COUNTERFACTUAL_KEYS: Final = {
    "decidable": "Whether a landing is known.",
    "why": "If not, why.",
    "fired_ms": "Likeliest firing, since the request.",
    "contact_ms": "Likeliest contact; also where only the phase is too uncertain.",
    "slip_rpm": "Likeliest slip at contact.",
    "phase_deg": "Middle of the 95 % interval; 0 is the middle of a gap.",
    "phase_low_deg": "Its lower end.",
    "phase_high_deg": "Its upper end.",
    "contact_probability": "Chance that the first contact is in a gap.",
    "beyond_record_ms": "For how long before the landing the recorded trajectory had ended.",
}
"""Of `counterfactual` in such a row."""

STRATEGY_KEYS: Final = {
    "shifts": "Number of judged shifts.",
    "refused": "Requests that the controller did not begin, as one for a gear in which the input "
    "shaft would turn too fast, or while a sensor is lost; they are in no other figure.",
    "first_contact_gap": "Share of shifts whose first contact was in a gap, by the rig's truth "
    "(`rate`, `ci95`); of those with dog teeth to meet, which changes of the splitter alone have "
    "not.",
    "promise": "Of the `shifts` fired once at a known phase: the mean probability of the gap as "
    "predicted at the firing (`said`), and how often it was met (`kept`); none of a strategy that "
    "does not aim.",
    "duration_ms": "From request to outcome, including shifts that were not engaged: mean, p50, "
    "p99, intervals.",
    "after_ramp_ms": "The duration from the end of the torque ramp, which is the same for every "
    "strategy.",
    "impact_j": "Lost in flank impacts until the gear has locked, all attempts (mean, p99, "
    "interval); `incomplete`: shifts whose gear had not locked 0.4 s after the outcome. Always 0 "
    "in the preset `thesis`.",
    "phases_ms": "Mean of each part of a shift over the shifts that have it: `ramp_ms` (request "
    "until the clutch sets off), `parting_ms`, `pull_out_ms`, `raising_ms` (downshifts), "
    "`brake_on_ms`, `braking_ms`, `release_ms`, `entry_ms` (contact to lock), `seen_ms`, which add "
    "up to the duration; then `closing_ms`, from the lock until the plates meet.",
    "bound_ms": "The kinematic minimum: plates parted, full brake over the whole slip, entry.",
    "over_minimum": "`after_ramp_ms` over `bound_ms`.",
    "aborted": "Share of shifts whose sleeve was stopped short of the teeth, once or more (`rate`, "
    "`ci95`).",
    "aborts_mean": "How often in a shift, on average.",
    "retries": "Attempts after the first.",
    "blocked": "Attempts that stuck tooth on tooth.",
    "outside_window": "Contacts of any gear at a slip outside the guard's window.",
    "bounced_off": "Shifts whose first contact was in a gap and that a flank bounced off.",
    "ratchets": "How often a flank bounced a sleeve off.",
    "not_engaged": "Shifts that did not end in gear.",
    "phase_error_mean_deg": "True phase at first contact less the target.",
    "phase_error_sd_deg": "Its standard deviation.",
    "slip_rpm_mean": "Mean slip at first contact.",
    "reference_known": "Share of shifts fired with a known phase reference.",
    "reference_sources": "Of all shifts, the share that knew it `measured` in mesh, `restored` "
    "with the tooth numbers, `narrowed` by other gears.",
    "by_gear": "The same by target gear of the main box, with its ratio.",
}
"""Of `strategies.NAME` of `campaign`."""
