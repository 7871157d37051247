# SPDX-License-Identifier: BSD-3-Clause
"""What a node says of how its map does: in its log, and as diagnostics."""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ndtree.live.mapper import LiveMapper
from ndtree.live.messages import MessagesIntake
from ndtree.live.ros.messages import header
from ndtree.live.ros.middleware import Level, Middleware
from ndtree.live.ros.parameters import in_parameters
from ndtree.live.settings import LiveSettings

#: For so long nothing is said of a clock that does not begin [s].
WAITS = 3.0
#: How often it is said why nothing is mapped [s].
SAYS = 5.0


class Reports:
    """Says what has changed since it was said."""

    def __init__(
        self, node: Middleware, mapper: LiveMapper, intake: MessagesIntake, how: LiveSettings
    ) -> None:
        self._node, self._mapper, self._intake = node, mapper, intake
        self._localizer, self._slam = how.localizer, how.slam
        self._announced: list[str] = []
        self._began = time.monotonic()
        self._waits_for_clock = True
        self._before = 0, 0.0
        self._said = float("-inf")
        self._failed: dict[str, str] = {}
        self._verdict = "too early"
        self._status = node.publisher(DiagnosticArray, "/diagnostics", depth=10)

    def decisions(self) -> bool:
        """Say what was decided, or why nothing is mapped; whether that was decided since the last time."""
        intake = self._intake
        if self._waits_for_clock and time.monotonic() - self._began >= WAITS:
            self._waits_for_clock = False
            if self._node.now() == 0:
                self._node.say(
                    Level.warning, "use_sim_time is set, and nothing comes on /clock: no time passes"
                )
        if intake.log is None:
            if self._mapper.undecided and time.monotonic() - self._said >= SAYS:
                self._said = time.monotonic()
                self._node.say(Level.warning, in_parameters(self._mapper.undecided))
            return False
        if self._announced == intake.notes:
            return False
        for line in intake.said():
            if line not in self._announced:
                self._node.say(Level.info, in_parameters(line))
        self._announced = list(intake.notes)
        return True

    def failures(self) -> None:
        """Say what has gone wrong since the last time in a sink; the map goes on."""
        failures = dict(self._mapper.failures)
        for sink, error in failures.items():
            if self._failed.get(sink) != error:
                self._node.say(Level.error, f"{sink}: {error}")
        self._failed = failures

    def doubts(self, *, again: bool = False) -> None:
        """Say whether poses are to be trusted where that is another than before."""
        if self._slam is None or (self._slam.verdict == self._verdict and not again):
            return
        self._verdict = self._slam.verdict
        self._node.say(Level.warning if self._slam.doubts else Level.info, self._slam.summary())

    def diagnose(self, lost: int) -> None:
        """Publish how the map does.

        `lost`: Messages that the middleware says it has lost.
        """
        mapper, now = self._mapper, self._node.now()
        mapped, since = self._before
        rate = (mapper.figures.mapped - mapped) / (now - since) if now > since else 0.0
        self._before = mapper.figures.mapped, now
        values = self._values(rate, lost)
        name = self._node.name.rpartition("/")[2]
        status = DiagnosticStatus(name=f"{name}: map", hardware_id="", level=DiagnosticStatus.OK)
        if mapper.has_map:
            stats = mapper.snapshot().stats()
            values["cells"] = stats.observed_leaves
            values["memory [MiB]"] = f"{stats.memory_bytes / 2**20:.1f}"
        status.message = f"{rate:.1f} scans/s"
        wrong = self._wrong(rate)
        if wrong:
            status.level, status.message = DiagnosticStatus.WARN, wrong
        status.values = [KeyValue(key=key, value=str(one)) for key, one in values.items()]
        self._status.publish(DiagnosticArray(header=header("", now), status=[status]))

    def _wrong(self, rate: float) -> str:
        """What is wrong first; empty if nothing is."""
        mapper = self._mapper
        if self._localizer is not None and self._localizer.is_lost:
            return "lost in the map"
        if not mapper.has_map:
            return in_parameters(mapper.undecided) or "nothing to map yet"
        if rate == 0 or mapper.failures:
            return next(iter(mapper.failures.values()), "no scans are mapped")
        return "" if self._slam is None else next(iter(self._slam.doubts), "")

    def _values(self, rate: float, lost: int) -> dict[str, Any]:
        figures = self._mapper.figures
        values: dict[str, Any] = {
            "rate [Hz]": f"{rate:.1f}",
            "delay, median [ms]": f"{1e3 * figures.delay(0.5):.1f}",
            "delay, 99 % [ms]": f"{1e3 * figures.delay(0.99):.1f}",
            "received": figures.received,
            "mapped": figures.mapped,
            "dropped": figures.dropped,
            "lost by the middleware": lost,
            "late poses": figures.late_poses,
            "corrections": figures.corrections,
            "waiting": figures.waiting,
            **{f"left out, {kind}": count for kind, count in figures.left_out.items()},
            **{f"{sink} failed": error for sink, error in self._mapper.failures.items()},
        }
        if self._localizer is not None:
            values |= {"lost now": self._localizer.is_lost, "times lost": self._localizer.times_lost}
        if self._slam is not None:
            said = self._slam.figures()
            doubts = "; ".join(self._slam.doubts)
            values |= {"poses": said["verdict"], "loops": said.get("loops", 0), "doubts": doubts}
        return values
