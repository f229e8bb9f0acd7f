"""Clutch actuator and engine requests of the truck: what drives the plant's clutch and engine.

The clutch moves linearly, the as-built delay from one end to the other; the plates touch at the
kiss point. Without a valid command for 100 ms it opens. The engine obeys a J1939 TSC1 request for
100 ms; without one a driver holds the main shaft's speed while clutch and gear are in, and the idle
governor works otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.sheet import Clutch
from meshpoint.rig_sim.orders import EngineRequest
from meshpoint.rig_sim.parts.engine import DRIVE, IDLE, SPEED_CONTROL, TORQUE_CONTROL
from meshpoint.rig_sim.shared.sleeves import NEVER_US
from meshpoint.rig_sim.shared.valve_drivers import EXPIRY_US
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.units import SECOND_US

LEAST_DELAY_S: Final = 1e-3
NO_REQUEST: Final = EngineRequest(None, None)


class TruckClutch:
    """The actuator, with position 0 (open) to 1 (closed), and the state of the plates."""

    def __init__(
        self, plant: TruckPlant, clutch: Clutch, note: Callable[[EngagementEvent], None]
    ) -> None:
        """`note` is called when it sets off, and when the plates part or meet."""
        self._plant = plant
        self._clutch = clutch
        self._note = note
        self._closing = True
        self._kiss_us = NEVER_US
        self._end_us = NEVER_US
        self._expiry_us = float(EXPIRY_US)
        self.stuck = False

    @property
    def next_us(self) -> float:
        """When the plates meet or part, an end is reached, or the command expires."""
        return min(self._kiss_us, self._end_us, self._expiry_us)

    def command(self, close: bool, time_us: float) -> None:
        """A valid command."""
        self._go(close, time_us)
        self._expiry_us = time_us + EXPIRY_US

    def renew(self, close: bool, time_us: float) -> bool:
        """Extends the present command if this one is the same and in time. False if it must go
        through `command`."""
        if close is not self._closing or self._expiry_us <= time_us:
            return False
        self._expiry_us = time_us + EXPIRY_US
        return True

    def due(self, time_us: float) -> None:
        """Do what is due now."""
        if self._expiry_us <= time_us:
            self._expiry_us = NEVER_US
            self._go(False, time_us)
        if self._kiss_us <= time_us:
            self._kiss_us = NEVER_US
            self._touch()
        if self._end_us <= time_us:
            self._end_us = NEVER_US
            self._plant.y.clutch = float(self._closing)
            self._plant.g.clutch_rate = 0.0

    def grips(self) -> None:
        """The plates have the same speed: they hold while the torque is within their capacity."""
        self._plant.smooth(at.PLATE)
        self._plant.join(at.CLUTCH, 1.0)

    def slips(self) -> None:
        """The torque exceeds what the plates can carry."""
        torque = self._plant.link_nm(at.CLUTCH)
        self._plant.chain.open(at.CLUTCH)
        self._plant.rub(at.PLATE, at.CLUTCH, 1.0, 0.0, 1.0 if torque > 0.0 else -1.0)

    def _go(self, close: bool, time_us: float) -> None:
        if close is self._closing or self.stuck:
            return
        plant, kiss = self._plant, self._plant.p.plates.kiss
        self._closing = close
        self._note(EngagementEvent.CLUTCH_CLOSES if close else EngagementEvent.CLUTCH_OPENS)
        delay_s = self._clutch.close_delay_s if close else self._clutch.open_delay_s
        rate = (1.0 if close else -1.0) / max(delay_s, LEAST_DELAY_S)
        position = plant.y.clutch
        plant.g.clutch_rate = rate
        self._end_us = time_us + (float(close) - position) / rate * SECOND_US
        to_kiss = (kiss - position) / rate
        touches = to_kiss > 0.0 and kiss < 1.0
        self._kiss_us = time_us + to_kiss * SECOND_US if touches else NEVER_US

    def _touch(self) -> None:
        met = self._closing
        self._note(EngagementEvent.PLATES_MET if met else EngagementEvent.PLATES_PARTED)
        if met:
            self._plant.rub(at.PLATE, at.CLUTCH, 1.0, 0.0)
        else:
            self._plant.smooth(at.PLATE)
            self._plant.chain.open(at.CLUTCH)


class TruckEngine:
    """The engine's mode: a TSC1 request, the driver, or the idle governor."""

    def __init__(self, plant: TruckPlant) -> None:
        self._plant = plant
        self._request = NO_REQUEST
        self._expiry_us = NEVER_US
        self.deaf = False
        self.settle()

    @property
    def next_us(self) -> float:
        """When the request expires."""
        return self._expiry_us

    def request(self, request: EngineRequest, time_us: float) -> None:
        """A TSC1 frame."""
        if self.deaf:
            return
        self._request = request
        self._expiry_us = NEVER_US if request == NO_REQUEST else time_us + EXPIRY_US
        self.settle()

    def due(self, time_us: float) -> None:
        """Do what is due now."""
        if self._expiry_us <= time_us:
            self._expiry_us = NEVER_US
            self._request = NO_REQUEST
            self.settle()

    def settle(self) -> None:
        """Selects the engine's mode. Call it after any change of clutch or gear."""
        plant, request = self._plant, self._request
        through = all(map(plant.chain.is_rigid, (at.CLUTCH, at.RANGE))) and plant.splitter_is_in
        driving = through and plant.shafts.lock is not None
        if request.speed_rad_s is not None:
            mode, target = SPEED_CONTROL, request.speed_rad_s
        elif request.torque_share is not None:
            mode = TORQUE_CONTROL
            target = request.torque_share * plant.p.engine.most_nm
        elif driving:
            if plant.g.engine_mode == DRIVE:
                return  # the driver holds the speed taken up before
            mode, target = DRIVE, self._cruise_rad_s()
        else:
            mode, target = IDLE, 0.0
        plant.g.engine_mode, plant.g.engine_target = mode, target

    def _cruise_rad_s(self) -> float:
        """The governor's target that just carries the road's resistance at the present speed."""
        plant, shafts = self._plant, self._plant.shafts
        gear = shafts.lock.gear if shafts.lock is not None else MainGear.THIRD
        through = shafts.split_ratio * plant.ratio(gear) * shafts.range_ratio
        load_nm = plant.resistance_nm() * through
        return plant.y.speed_rad_s[at.ENGINE] + load_nm / plant.p.engine.governor_nms
