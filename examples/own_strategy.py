"""A strategy of your own, in a file outside the package.

    meshpoint simulate --strategy examples/own_strategy.py:NextGap
    meshpoint campaign --strategy target_phase,examples/own_strategy.py:NextGap --runs 20

It asks when the next gap comes by, and meets that one. It does not weigh that gap against the ones
after it, nor against how well the phase is known, as `target_phase` does.

All times are microseconds of the sensor clock, angles are radians, speeds rad/s. Nothing here can
damage the gearbox: the guard judges every valve command, and an error switches all valves off.
"""

RPM = 3.14159 / 30.0


class NextGap:
    """Meets the first gap that comes by once the slip is below 30 rpm."""

    aims = True  # needs the phase of the teeth; until it is known, speed_window acts
    fire_slip_rad_s = 30 * RPM  # further above it than drag alone can shed, the brake helps

    def __init__(self, sheet, settings):
        """The gearbox's data sheet and the controller's settings."""
        self.pitch_rad = sheet.dog.pitch_rad
        brake = sheet.brake  # a released brake has died away after three time constants
        self.settle_us = round(1e6 * (brake.valve_delay_s + 3 * brake.time_constant_s))

    def release(self, predictor, now_us, earliest_us):
        """When to release the brake, and when contact is expected then."""
        latest_us = earliest_us + 1_000_000
        release_us = predictor.release_time_us(earliest_us, latest_us, 30 * RPM, self.settle_us)
        return release_us, release_us + self.settle_us

    def contact(self, predictor, now_us, earliest_us):
        """When the sleeve should meet its gear; None: not yet, ask again in 10 ms."""
        first_us = earliest_us + predictor.delay_us  # the sleeve is on its way for so long
        phase_rad, slip_rad_s = predictor.phase_and_slip(first_us)
        if slip_rad_s > self.fire_slip_rad_s:
            return None
        for contact_us in range(first_us, first_us + 200_000, 500):
            phase_rad, slip_rad_s = predictor.phase_and_slip(contact_us)
            if slip_rad_s < 1 * RPM:
                break  # waiting would not bring another gap
            from_gap_rad = (phase_rad + self.pitch_rad / 2) % self.pitch_rad - self.pitch_rad / 2
            if abs(from_gap_rad) < slip_rad_s * 500e-6:
                return contact_us
        return first_us
