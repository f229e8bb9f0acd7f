"""The layshaft's disc brake: torque, friction that changes, heat.

    T = C_db (p - p_touch)^+  m(w, T_d)                                  thesis 4.3, 4.4
    m = (1 - k_T (T_d - 40 degC)) (1 + k_w (w - w_ref))
    C dT_d/dt = T w - h (T_d - T_oil)

The pads touch at p_touch against their springs. Paper-on-steel friction falls by about a fifth
between 40 and 120 degC; its slope against speed has either sign, depending on the lining.
"""

from __future__ import annotations

from meshpoint.rig_sim.jit import part

LEAST_SHARE = 0.2


@part
def friction_share(
    omega_rad_s: float, disc_k: float, per_k: float, per_rad_s: float, at_k: float, at_rad_s: float
) -> float:
    """Friction over its nominal value; never less than a fifth."""
    share = (1.0 - per_k * (disc_k - at_k)) * (1.0 + per_rad_s * (abs(omega_rad_s) - at_rad_s))
    return max(share, LEAST_SHARE)


@part
def brake_nm(gauge_pa: float, touch_pa: float, gain_nm_pa: float, share: float) -> float:
    """Torque of the pressed disc, unsigned; at rest it is what the disc can hold."""
    return gain_nm_pa * max(gauge_pa - touch_pa, 0.0) * share


@part
def heating_k_s(
    power_w: float, disc_k: float, oil_k: float, heat_j_k: float, cooling_w_k: float
) -> float:
    """How fast the disc gets warmer."""
    return (power_w - cooling_w_k * (disc_k - oil_k)) / heat_j_k
