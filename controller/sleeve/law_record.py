"""From what is known of a sleeve's law to its part of a calibration file, and back."""

from __future__ import annotations

import numpy as np

from meshpoint.controller.settings.learned import SleeveLawRecord
from meshpoint.controller.sleeve.cylinder import (
    DAMPING,
    DEAD,
    DETENT,
    DETENT_UNIT_N,
    FEED,
    FRICTION,
    GAIN,
    IN_GEAR,
    LEFT,
    OFF,
    OFFSET,
    ON,
    PARAMETERS,
    VENT,
)
from meshpoint.controller.sleeve.law import LEFT_SD, OFFSET_UNIT_M, Prior

KEPT = [k for k in range(PARAMETERS) if k != LEFT]
"""What outlasts a movement."""
LEAST_VARIANCE = 1e-14


def law_record(known: Prior, movements: int) -> SleeveLawRecord:
    """What a calibration file keeps."""
    mean, factor = known.mean, np.exp(known.mean)
    covariance = known.covariance[np.ix_(KEPT, KEPT)]
    root = np.linalg.cholesky(covariance + LEAST_VARIANCE * np.eye(len(KEPT)))
    return SleeveLawRecord(
        movements=movements,
        on_delay_s=tuple(mean[ON : ON + 2].tolist()),
        off_delay_s=tuple(mean[OFF : OFF + 2].tolist()),
        filling=tuple(factor[FEED : FEED + 2].tolist()),
        friction=float(factor[FRICTION]),
        damping=float(factor[DAMPING]),
        dead_volume=float(factor[DEAD]),
        vent=float(factor[VENT]),
        detent_n=float(mean[DETENT]) * DETENT_UNIT_N,
        in_gear_n=float(mean[IN_GEAR]) * DETENT_UNIT_N,
        offset_m=float(mean[OFFSET]) * OFFSET_UNIT_M,
        gain=float(factor[GAIN]),
        root=tuple(root[np.tril_indices(len(KEPT))].tolist()),
    )


def known_from(record: SleeveLawRecord) -> Prior:
    """The inverse."""
    mean, covariance = np.zeros(PARAMETERS), np.zeros((PARAMETERS, PARAMETERS))
    mean[ON : ON + 2], mean[OFF : OFF + 2] = record.on_delay_s, record.off_delay_s
    factors = (record.friction, record.damping, record.dead_volume, record.vent)
    mean[FEED : FEED + 2], mean[FRICTION : VENT + 1] = np.log(record.filling), np.log(factors)
    mean[DETENT], mean[IN_GEAR] = record.detent_n / DETENT_UNIT_N, record.in_gear_n / DETENT_UNIT_N
    mean[OFFSET], mean[GAIN] = record.offset_m / OFFSET_UNIT_M, np.log(record.gain)
    root = np.zeros((len(KEPT), len(KEPT)))
    root[np.tril_indices(len(KEPT))] = record.root
    covariance[np.ix_(KEPT, KEPT)] = root @ root.T + LEAST_VARIANCE * np.eye(len(KEPT))
    covariance[LEFT, LEFT] = LEFT_SD**2
    return Prior(mean, covariance)
