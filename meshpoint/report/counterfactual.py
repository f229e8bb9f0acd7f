"""Where the tooth would have landed under another controller's commands, or why that is unknown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Counterfactual:
    """A landing worked out, or why there is none. Never a recorded outcome."""

    why: str = ""
    """Why it is not decidable; empty where it is."""
    fired_ms: float | None = None
    """When it would have fired, ms since the request."""
    contact_ms: float | None = None
    phase_deg: float | None = None
    """Middle of the interval, wrapped to the pitch; 0 is the gap's middle."""
    phase_low_deg: float | None = None
    phase_high_deg: float | None = None
    """Ends of the 95 % interval, not wrapped."""
    slip_rpm: float | None = None
    contact_probability: float | None = None
    """Of first meeting a gap."""
    beyond_record_ms: float | None = None
    """For how long before the landing the recorded trajectory had ended; 0: it lasted long
    enough."""
    trajectory: tuple[tuple[float, float, float], ...] = ()
    """The likeliest trajectory from the parting to the landing: ms since the request, slip in rpm,
    phase in deg unwrapped."""

    @property
    def decidable(self) -> bool:
        """Whether a landing is reported."""
        return not self.why


def undecidable(why: str) -> Counterfactual:
    """No landing, and the reason."""
    return Counterfactual(why=why)
