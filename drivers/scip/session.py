"""The talk with a sensor: find it, learn what it is, set its clock against ours, make it measure."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from drivers.base import SensorTrouble
from drivers.clock_sync import ClockSync, Unwrapped
from drivers.live_sensor import LOOK_UP_S, NoAnswer, Stopped
from drivers.scip import requests, status
from drivers.scip.replies import (
    DamagedReply,
    Parameters,
    RawScan,
    Reply,
    ReplyParser,
    info_of,
    is_scan,
    parameters_of,
    scan_of,
    timer_of,
)
from drivers.scip.requests import Window
from drivers.transport import Transport

ANSWER_S, TRIES = 0.4, 4  # a sensor answers at once, unless the request or its reply was bent
FIRST_SCAN_S = 6.0  # mirror and laser take their time
SILENT_S = 1.0
VERIFY_S = 15.0
EXCHANGES = 16
TIMER_BITS, TICK_S = 24, 1e-3
ASK_AGAIN_S = 5e-3


@dataclass
class Session:
    """One talk over an open line; a new one after every reconnect.

    ``clock`` maps the sensor's timer, in seconds, to the transport's clock. ``errors`` counts what goes wrong.
    Once ``stopped``, every wait ends with Stopped. Scans that come while something else is talked of (the sensor
    may still measure for an earlier talk) are kept: `stream` and `latest` give them first, `left` at the end.
    """

    line: Transport
    errors: Counter[str]
    version: dict[str, str] = field(default_factory=dict)
    state: dict[str, str] = field(default_factory=dict)
    clock: ClockSync = field(default_factory=lambda: ClockSync(TICK_S))
    timer: Unwrapped = field(default_factory=lambda: Unwrapped(TIMER_BITS))
    stopped: Callable[[], bool] = lambda: False
    _parser: ReplyParser = field(default_factory=ReplyParser)
    _pending: deque[Reply] = field(default_factory=deque)
    _kept: deque[Reply] = field(default_factory=deque)  # scans

    def __post_init__(self) -> None:
        self._parser.faults = self.errors

    # --- talking ------------------------------------------------------------------------------------

    def ask(self, request: bytes, timeout_s: float = ANSWER_S, tries: int = TRIES) -> Reply:
        """The reply to a request, asked again where it is bent or missing. Raises NoAnswer."""
        echo = request.rstrip(b"\n")
        for _ in range(tries):
            self.line.write(request)
            until_s = self.line.now_s() + timeout_s
            while (reply := self._next(until_s - self.line.now_s())) is not None:
                if reply.echo == echo and reply.status != status.STREAMED:
                    return reply
                self._keep(reply)
        raise NoAnswer(f"no answer to {echo.decode()}")

    def _next(self, timeout_s: float) -> Reply | None:
        """The next whole reply, None if there is none in time."""
        until_s = self.line.now_s() + timeout_s
        while not self._pending:
            if self.stopped():
                raise Stopped
            left_s = until_s - self.line.now_s()
            if left_s <= 0.0:
                return None
            chunk = self.line.read(min(left_s, LOOK_UP_S))
            if chunk:
                self._pending.extend(self._parser.feed(chunk, self.line.now_s()))
        return self._pending.popleft()

    def _keep(self, reply: Reply | None) -> None:
        """Put a scan aside that came while something else was waited for."""
        if reply is not None and is_scan(reply):
            self._kept.append(reply)

    def _take_kept(self, window: Window) -> Iterator[RawScan]:
        while self._kept:
            yield from self._scan(self._kept.popleft(), window)

    def left(self, window: Window) -> Iterator[RawScan]:
        """Scans that have come and nobody has taken, when the talk is over."""
        self._forget()
        yield from self._take_kept(window)

    def _accept(self, request: bytes, also: tuple[str, ...] = (), timeout_s: float = ANSWER_S) -> Reply:
        """Ask, and insist on status 00 (or another good one). Raises SensorTrouble with the status in words."""
        reply = self.ask(request, timeout_s)
        for _ in range(TRIES - 1):
            if reply.status == status.OK or reply.status in also:
                return reply
            reply = self.ask(request, timeout_s)  # the request itself may have been bent on its way
        if reply.status == status.OK or reply.status in also:
            return reply
        words = status.meaning(reply.command, reply.status)
        raise SensorTrouble(f"{reply.echo.decode()} is answered with {reply.status}: {words}")

    # --- beginning ----------------------------------------------------------------------------------

    def begin(self, baud: int | None) -> Parameters:
        """Find the sensor, take it to SCIP 2.0 and to ``baud``, read what it is, set the clock.

        Raises NoAnswer where nothing answers, SensorTrouble where it refuses.
        """
        self._find()
        if baud is not None and self.line.baud() not in (None, baud):
            self._change_baud(baud)
        parameters = self._parameters()
        with suppress(NoAnswer):  # what it tells of itself is good to know, no more
            self.state, _ = info_of(self.ask(requests.STATE))
        self._set_clock()
        return parameters

    def _find(self) -> None:
        """The bit rate at which the sensor understands us; over USB and TCP any."""
        now = self.line.baud()
        rates = [now] + [rate for rate in requests.BIT_RATES if rate != now]
        for rate in rates if now is not None else [None]:
            if rate is not None and rate != self.line.baud():
                self.line.set_baud(rate)
            self.quiet()
            for wake_up in (b"", requests.UPGRADE):  # SCIP 1.1 knows neither VV nor QT
                if wake_up:
                    self.line.write(wake_up)
                    self._keep(self._next(ANSWER_S / 2))  # 0: now SCIP 2.0; 0E: it was already
                try:
                    self.version, wrong = info_of(self.ask(requests.VERSION, ANSWER_S / 2, tries=2))
                except NoAnswer:
                    continue
                self.errors["info-sum"] += wrong
                return
        tried = ", ".join(map(str, rates)) + " baud" if now is not None else "this address"
        raise NoAnswer(f"no SCIP sensor answers (tried {tried})")

    def quiet(self) -> None:
        """Stop whatever it is still sending, and throw that away, but for whole scans."""
        self._parser.faults = Counter()  # at a wrong bit rate all of it is noise
        try:
            self.line.write(b"\n" + requests.QUIT + requests.QUIT)
            until_s = self.line.now_s() + SILENT_S
            while self.line.now_s() < until_s and (chunk := self.line.read(0.05)):
                self._pending.extend(self._parser.feed(chunk, self.line.now_s()))
        finally:
            self._parser.faults = self.errors
            self._forget()

    def _forget(self) -> None:
        self._parser.clear()
        for reply in self._pending:
            self._keep(reply)
        self._pending.clear()

    def _change_baud(self, baud: int) -> None:
        """Tell the sensor, then follow it; both lines are at ``baud`` afterwards."""
        reply = self._accept(requests.bit_rate(baud), also=("03",))
        if reply.status == "03":  # over USB it means the port that is not used
            return
        self.line.set_baud(baud)
        self._forget()
        self.version, _ = info_of(self.ask(requests.VERSION))

    def _parameters(self) -> Parameters:
        """Asked again where a sum is wrong, unless the sensor says the same twice: some send wrong sums."""
        told, before = "", None
        for _ in range(TRIES):
            info, wrong = info_of(self._accept(requests.PARAMETERS))
            self.errors["info-sum"] += wrong
            if wrong and info != before:
                before, told = info, told or "its lines are bent"
                continue
            try:
                return parameters_of(info)
            except ValueError as error:
                told = str(error)
        raise SensorTrouble(f"the sensor's parameters (PP) cannot be read: {told}")

    def _set_clock(self) -> None:
        """Ask for the timer at several phases of its tick. Without it, arrivals alone tell the time."""
        try:
            self._accept(requests.ADJUST_ON, also=("02",))
        except SensorTrouble:
            self.errors["no-time-adjust"] += 1
            return
        for n in range(EXCHANGES):
            request = requests.adjust_time("t" * (n % 3))
            sent_s = self.line.now_s()
            try:
                reply = self.ask(request, tries=1)
                device_s = self.timer(timer_of(reply)) * TICK_S
            except (NoAnswer, DamagedReply):
                self.errors["time-adjust"] += 1
                continue
            # on a real serial line the bytes themselves take their time; not more than the whole round trip
            trip_s = reply.received_s - sent_s
            to_s, back_s = self._on_the_line_s(len(request)), self._on_the_line_s(reply.bytes_long)
            share = min(1.0, trip_s / max(1e-9, to_s + back_s))
            self.clock.exchange(sent_s + share * to_s, device_s, reply.received_s - share * back_s)
        self._accept(requests.ADJUST_OFF, also=("03", "04"))

    def _on_the_line_s(self, count: int) -> float:
        """How long so many bytes take; none over USB and TCP."""
        baud = self.line.baud()
        return 10.0 * count / baud if baud else 0.0

    # --- measuring ----------------------------------------------------------------------------------

    def stream(self, window: Window) -> Iterator[RawScan]:
        """Scans of MD or MS as they come. Raises NoAnswer when it falls silent, SensorTrouble when it gives up."""
        self._accept(window.stream())
        yield from self._take_kept(window)
        patience_s = FIRST_SCAN_S
        while (reply := self._next(patience_s)) is not None:
            patience_s = SILENT_S * (1 + window.skip)
            if is_scan(reply):
                yield from self._scan(reply, window)
            elif reply.command in ("MD", "MS") and reply.status != status.OK:
                self.errors[f"status-{reply.status}"] += 1
                if status.is_hardware_trouble(reply.status):
                    raise SensorTrouble(f"status {reply.status}: {status.meaning('MD', reply.status)}")
                patience_s = VERIFY_S  # it looks into an error; 98 tells that it goes on
        raise NoAnswer("silent")

    def latest(self, window: Window) -> Iterator[RawScan]:
        """Scans of GD or GS, each asked for: for lines too slow for a stream. Raises as `stream` does."""
        self._laser_on()
        last_ms, patience_s = -1, FIRST_SCAN_S
        while True:
            reply = self.ask(window.latest(), patience_s, tries=2)
            patience_s = SILENT_S + self._on_the_line_s(window.reply_bytes)
            if reply.status == status.LASER_OFF:
                self.errors["laser-off"] += 1
                self._laser_on()
            elif status.is_hardware_trouble(reply.status):
                self.errors[f"status-{reply.status}"] += 1
                raise SensorTrouble(f"status {reply.status}: {status.meaning('GD', reply.status)}")
            elif reply.status != status.OK:
                self.errors[f"status-{reply.status}"] += 1
            self._keep(reply)
            for scan in self._take_kept(window):
                if scan.timestamp_ms != last_ms:
                    yield scan
                else:
                    self._keep(self._next(ASK_AGAIN_S))  # the mirror has not come round yet
                last_ms = scan.timestamp_ms

    def _laser_on(self) -> None:
        self._accept(requests.LASER_ON, also=(status.ALREADY_ON,))

    def _scan(self, reply: Reply, window: Window) -> Iterator[RawScan]:
        try:
            yield scan_of(reply, window)
        except DamagedReply as error:
            self.errors[error.fault] += 1

    # --- ending -------------------------------------------------------------------------------------

    def reset(self) -> None:
        """RS: laser off, timer and settings as after power on."""
        self.quiet()
        self.line.write(requests.RESET)
        self._keep(self._next(ANSWER_S))
