"""The layshaft's disc brake: torque, friction that changes, heat.

    T = C_db (p - p_touch)^+  m(w, T_d)                                  thesis 4.3, 4.4
    m = (1 - k_T (T_d - 40 degC)) (1 + k_w (w - w_ref))
    C dT_d/dt = T w - h (T_d - T_oil)

The pads touch at p_touch against their springs. Paper-on-steel friction falls by about a fifth
between 40 and 120 degC; its slope against speed has either sign, depending on the lining.
"""

from __future__ import annotations

from meshpoint.kernels.jit import piece
from meshpoint.kernels.structures import Record

LEAST_FRICTION_SHARE = 0.2


class DiscBrake(Record):
    """The brake as built."""

    gain_nm_pa: float  # C_db
    touch_pa: float
    fade_per_k: float
    fade_per_rad_s: float
    reference_k: float
    reference_rad_s: float
    heat_j_k: float
    cooling_w_k: float


@piece
def friction_share(omega_rad_s: float, disc_k: float, brake: DiscBrake) -> float:
    """Friction over its nominal value; never less than a fifth."""
    share = (1.0 - brake.fade_per_k * (disc_k - brake.reference_k)) * (
        1.0 + brake.fade_per_rad_s * (abs(omega_rad_s) - brake.reference_rad_s)
    )
    return max(share, LEAST_FRICTION_SHARE)


@piece
def brake_nm(gauge_pa: float, share: float, brake: DiscBrake) -> float:
    """Torque of the pressed disc, unsigned; at rest it is what the disc can hold."""
    return brake.gain_nm_pa * max(gauge_pa - brake.touch_pa, 0.0) * share


@piece
def heating_k_s(power_w: float, disc_k: float, oil_k: float, brake: DiscBrake) -> float:
    """How fast the disc gets warmer."""
    return (power_w - brake.cooling_w_k * (disc_k - oil_k)) / brake.heat_j_k
