"""Main sleeves that are a pure delay from activation to contact (thesis 6.2; laws in `sleeves`)."""

from __future__ import annotations

from abc import abstractmethod
from typing import Generic, TypeVar

from meshpoint.gearbox.gears import MAIN_SLEEVES, SIDE_OF, DogGear, Sleeve
from meshpoint.rig_sim.shared.engagement import Engagement
from meshpoint.rig_sim.shared.sleeves import SleeveAxis, SleeveState

AxisT = TypeVar("AxisT", bound=SleeveAxis)


class EngagementByDelay(Engagement[AxisT], Generic[AxisT]):
    """An activation moves a sleeve that stands by one position, after a drawn delay."""

    def due(self, time_us: float) -> None:
        """Do what is due now; the plant stands at this instant."""
        for name, sleeve in self.sleeves.items():
            if sleeve.contact_us <= time_us:
                self._contact(name, time_us)
            if sleeve.unmesh_us <= time_us:
                self._unmesh(name)
            if sleeve.neutral_us <= time_us:
                sleeve.arrive(time_us)
                self._blocked.discard(name)

    def script_release(
        self, time_us: float, duration_s: float, names: tuple[Sleeve, ...] = MAIN_SLEEVES
    ) -> None:
        """The bench moves these sleeves to neutral, within this time."""
        for sleeve in map(self.sleeves.__getitem__, names):
            if sleeve.state in (SleeveState.NEUTRAL, SleeveState.RETRACT):
                continue  # neutral is there or near: nothing takes a sleeve longer than the script
            if sleeve.stands(time_us):
                sleeve.release(time_us, duration_s)
            else:
                sleeve.let_go(time_us)

    def script_engage(self, gear: DogGear, time_us: float) -> None:
        """The bench moves the sleeve of this gear in, with a delay drawn as ever."""
        where = SIDE_OF[gear]
        delay_s = self._delay_s(where.sleeve, where.direction)
        self.sleeves[where.sleeve].engage(time_us, where.direction, delay_s)

    def _drive(
        self, name: Sleeve, direction: int, on: bool, is_opposed: bool, time_us: float
    ) -> None:
        """The coil that moves a sleeve this way has been switched; is_opposed: the opposite one is
        on."""
        if not on:
            self._valve_off(name, direction, time_us)
        elif is_opposed:
            self._valve_off(name, -direction, time_us)
        else:
            self._valve_on(name, direction, time_us)

    def _valve_on(self, name: Sleeve, direction: int, time_us: float) -> None:
        sleeve = self.sleeves[name]
        if not sleeve.stands(time_us):
            self._say(time_us, f"activation of {name.name} lost: {sleeve.state.name}")
        elif sleeve.state is SleeveState.NEUTRAL:
            sleeve.engage(time_us, direction, self._delay_s(name, direction))
        elif sleeve.side == -direction:
            sleeve.release(time_us, self._delay_s(name, direction))

    def _valve_off(self, name: Sleeve, direction: int, time_us: float) -> None:
        sleeve = self.sleeves[name]
        if sleeve.side == direction:
            under_way = sleeve.state in (SleeveState.APPROACH, SleeveState.FACE, SleeveState.ENTER)
            if under_way and not sleeve.stands(time_us):
                sleeve.let_go(time_us)
        elif (
            sleeve.state is SleeveState.RETRACT
            and sleeve.meshed
            and not sleeve.has_set_off(time_us)
        ):
            sleeve.hold(time_us)

    @abstractmethod
    def _delay_s(self, name: Sleeve, direction: int) -> float:
        """Delay from the valve's activation to contact or neutral; direction of the movement."""
