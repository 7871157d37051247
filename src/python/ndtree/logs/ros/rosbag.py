# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2, read without ROS: scans of their sensors, each with the pose of its time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ndtree.base.scan import Scan
from ndtree.logs.core.failures import NoPose
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.source import WrongOption
from ndtree.logs.core.zeros import NO_ECHO, checked
from ndtree.logs.folders.depth_image import check_stride
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.choice import in_order as in_order_of_sight
from ndtree.logs.ros.choice import poor, sights
from ndtree.logs.ros.files.bag import open_bag
from ndtree.logs.ros.merging import in_order
from ndtree.logs.ros.messages.beams import IMAGES, SENSOR_NAMES, SENSORS, stamp_of
from ndtree.logs.ros.placement.advice import without_sensors
from ndtree.logs.ros.placement.level import dimension_of
from ndtree.logs.ros.placement.placement import Asked, Placement
from ndtree.logs.ros.placement.placing import find_places, poses_topic
from ndtree.logs.ros.placement.standing import Standing
from ndtree.logs.ros.sensors import Sensor, Wanted, chosen, encodings_in, listed, readable
from ndtree.logs.ros.survey import Survey
from ndtree.logs.ros.sweep_choice import understood

#: Stamps and poses that are further apart are of two clocks [s].
TWO_CLOCKS = 1.0
#: The note about messages with senseless times of beams, or a senseless largest range.
_SENSELESS = "the times of beams make no sense, and all beams count as measured at the stamp"
_UNLIMITED = "the largest range makes no sense, and counts as not given"


class RosbagLog(SizedLog):
    """The messages of one or more sensor topics with their poses.

    Transforms, poses, cameras and the times of all scans are read when the log is opened, measurements while
    it is iterated. The length is the topics' number of messages.

    Attributes
    ----------
    sensors : list of Sensor
    sweeps : dict of str to Sweep
        By topic, what the times of beams mean.
    fixed_frame : str
        Of the map.
    time_offset : float
        Added to the stamps of scans [s].
    clock : Clock
    """

    format = "rosbag"
    is_raw = True
    path: str

    def __init__(
        self,
        path: str,
        *,
        dim: int | None = None,
        topic: str | Sequence[str] | None = None,
        fixed_frame: str | None = None,
        odometry: str | None = None,
        poses: str | None = None,
        trajectory: str | None = None,
        still: bool = False,
        mount: str | None = None,
        sensor_frame: str | None = None,
        base_frame: str | None = None,
        time_offset: float = 0.0,
        deskew: bool = True,
        camera: str | None = None,
        pixel_stride: int = 1,
        zero_is: str | None = None,
    ) -> None:
        ways = {
            "fixed_frame": fixed_frame, "odometry": odometry, "poses": poses, "trajectory": trajectory,
        }  # fmt: skip
        given = [name for name, value in ways.items() if value is not None]
        given += ["still"] if still and given != ["fixed_frame"] else []
        if len(given) > 1:
            raise WrongOption(f"{path}: {' and '.join(given)}: expected one of them")
        if not np.isfinite(time_offset):
            raise WrongOption(f"time_offset = {time_offset:g} s: must be finite")
        check_stride(pixel_stride)
        checked(path, zero_is)
        wanted = [Wanted.of(one) for one in ([topic] if isinstance(topic, str) else topic or [])]
        self.time_offset = float(time_offset)
        with open_bag(path) as bag:
            self._damage = bag.damage
            topics = chosen(bag, wanted) if wanted else readable(bag)
            seen = sights(bag, topics) if not wanted and len(topics) > 1 else {}
            topics = in_order_of_sight(topics, seen) if seen else topics
            if not topics:
                raise ValueError(without_sensors(bag.path, bag.topics, encodings_in(bag), bag.unread))
            names = ", ".join(one.name for one in topics)
            if camera is not None and not any(one.type in IMAGES for one in topics):
                raise WrongOption(f"{path}: camera: {names} has no depth images")
            if len(wanted) > 1 and (mount is not None or sensor_frame is not None):
                what = "mount" if mount is not None else "sensor_frame"
                raise WrongOption(f"{path}: {what}: is of one sensor, and there are {len(topics)}: {names}")
            source = poses_topic(bag, odometry, poses)
            asked = Asked(fixed_frame, source, trajectory, still, mount, sensor_frame, base_frame)

            def surveyed(poses: str | None) -> Survey:
                return Survey(bag, [one.name for one in topics], poses, self.time_offset)

            found = find_places(bag, surveyed, topics, asked, None if wanted else poor(seen))
            survey, self._places = found.survey, found.places
            self.clock, self._damaged = survey.clock, survey.damaged
            notes = [_begun_again(stamp) for stamp in self.clock.falls] + found.notes
            wanted = wanted or [Wanted(one.name) for one in found.topics]
            left = [one for one in topics if one not in found.topics]
            if left:
                notes.append(f"--topic would take another sensor than {found.topics[0].name}: {listed(left)}")
            self.sensors = [
                Sensor(
                    bag, one, survey, sigma=want.sigma, camera=camera, pixel_stride=pixel_stride,
                )
                for one, want in zip(found.topics, wanted)
            ]  # fmt: skip
        first = self._places[self.sensors[0].topic.name]
        self.fixed_frame = first.fixed_frame
        cameras = [sensor.camera_topic for sensor in self.sensors if sensor.camera_topic]
        self.uses = (
            " and ".join(sensor.description for sensor in self.sensors)
            + (f", cameras from {' and '.join(cameras)}" if cameras else "")
            + (", " if still else f", poses in {self.fixed_frame} from ")
            + first.origin
        )
        super().__init__(path, dim=dimension_of(path, self.sensors, self._places, dim))
        self.zero_is = zero_is
        self.may_be_zero = any(sensor.is_planar for sensor in self.sensors)
        self.is_depth_camera = all(sensor.topic.type in IMAGES for sensor in self.sensors)
        self.knows_no_returns = any(sensor.is_planar for sensor in self.sensors)
        self._elsewhere = {one.topic.name: self._unplaced(one, asked) for one in self.sensors}
        self.sweeps, said = understood(path, self.sensors, self._places, self.clock, self.time_offset, deskew)
        units = [sensor.note for sensor in self.sensors if sensor.note]
        self.notes = [*notes, *units, *first.notes, *self._damage, *said]
        self.hint = _clocks(self.sensors[0], survey, self.spans)
        self.fixed_note = len(self.notes)

    def __len__(self) -> int:
        return sum(sensor.topic.messages for sensor in self.sensors)

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """Of all scans, by the poses' clock, and of the first sensor's poses unless it stands."""
        stamps = [stamp for sensor in self.sensors for stamp in sensor.seen.own_stamps]
        spans = {"scans": (min(stamps), max(stamps))} if stamps else {}
        place = self.place
        first, last = place.tree.span(place.fixed_frame, place.observer or place.frame)
        return {**spans, "poses": (first, last)} if np.isfinite(first) else spans

    @property
    def place(self) -> Placement:
        """How the first sensor's poses are found."""
        return self._places[self.sensors[0].topic.name]

    def _unplaced(self, sensor: Sensor, asked: Asked) -> list[str]:
        """Frames of some of a topic's messages without a pose."""
        place, others = self._places[sensor.topic.name], sensor.seen.frames.keys() - {sensor.seen.frame}
        if asked.sensor_frame is not None:  # Whatever the messages say.
            return []
        known = place.tree.connected(place.fixed_frame) if place.is_own else []
        return sorted(others - set(known))

    def _elsewhere_said(self, sensor: Sensor) -> str:
        others = self._elsewhere[sensor.topic.name]
        count = sum(sensor.seen.frames[frame] for frame in others)
        return (
            f"{count} of {sensor.topic.messages} messages of {sensor.topic.name} are left out: they are in "
            f"{', '.join(others) or 'no frame'}, and nothing says where that is"
        )

    def _scans(self) -> Iterator[Scan]:
        by_name = {sensor.topic.name: sensor for sensor in self.sensors}
        del self.notes[self.fixed_note :]
        for damage in self._damage if self.strict else ():
            raise ValueError(f"{damage}, expected a whole bag")
        for error in self._damaged:
            self._skip("damaged messages", error)
        self._endless = 0
        self._told: dict[tuple[str, str], tuple[int, str]] = {}
        watched = {
            sensor.topic.name: Standing(sensor.is_planar)
            for sensor in self.sensors
            if self._places[sensor.topic.name].stands
        }
        try:
            yield from self._read(by_name, watched)
        finally:
            self._note_what_was_seen(watched)

    def _read(self, by_name: dict[str, Sensor], watched: dict[str, Standing]) -> Iterator[Scan]:
        with open_bag(self.path) as bag:
            messages = bag.messages(list(by_name), on_damage=lambda error: self._skip("damaged bags", error))
            if len(by_name) > 1:
                messages = in_order(messages, self.clock)
            numbers = self._numbers = dict.fromkeys(by_name, -1)
            for raw in messages:
                name = raw.connection.topic
                sensor, place = by_name[name], self._places[name]
                numbers[name] += 1
                where = f"{self.path}: {name}: message {numbers[name]}"
                try:
                    if raw.connection.type not in SENSORS:
                        raise ValueError(f"is of type {raw.connection.type}, expected {SENSOR_NAMES}")
                    message = bag.decoded(raw)
                    own = plain(message.header.frame_id)
                    stamp = self.clock.stamp((name, own), 1e-9 * raw.received, stamp_of(message))
                    measured = sensor.beams(message, stamp, self.no_return_range, self.zero_is == NO_ECHO)
                    beams = self.sweeps[name].applied(measured)
                except ValueError as error:
                    self._skip("damaged messages", ValueError(f"{where}: {error}"))
                    continue
                if own in self._elsewhere[name]:
                    wrong = ValueError(f"{where}: is in {own}, expected {sensor.seen.frame}")
                    self._leave_out("messages in other frames", wrong, self._elsewhere_said(sensor))
                    continue
                frame = own if place.is_own else place.frame
                stamp = self.clock.time((name, own), 1e-9 * raw.received, stamp)
                try:
                    ends, origins = place.in_map(frame, beams, stamp + self.time_offset)
                except NoPose as error:
                    self._leave_out_unposed(NoPose(f"{where}: {error}", error.where, error.seconds))
                    continue
                self._endless += beams.endless
                if beams.senseless and self.sweeps[name].is_used and not place.stands:
                    self._tell(name, numbers[name], _SENSELESS, beams.senseless)
                if beams.unlimited:
                    self._tell(name, numbers[name], _UNLIMITED, beams.unlimited)
                self.zeros += beams.zeros
                if name in watched:
                    watched[name].add(beams)
                sigma = None if sensor.sigma is None else np.full(len(ends), sensor.sigma)
                yield Scan(ends[:, : self.dim], origins[..., : self.dim], beams.returned, stamp, sigma)

    def _tell(self, name: str, number: int, what: str, said: str) -> None:
        """Count messages of a topic in which something is wrong that they are mapped in spite of."""
        count, first = self._told.get((name, what), (0, f"message {number}: {said}"))
        self._told[name, what] = count + 1, first

    def _note_what_was_seen(self, watched: dict[str, Standing]) -> None:
        if self._endless:
            self.notes.append(
                f"{self._endless} beams met nothing, but range_max is infinite or not given: they say "
                "nothing; with --max-range they are free up to there"
            )
        for (name, what), (count, first) in self._told.items():
            self.notes.append(
                f"{name}: in {count} of {self._numbers[name] + 1} messages {what}; the first: {first}"
            )
        for name, standing in watched.items():
            warning = standing.warning(name, self._places[name])
            if warning is not None:
                self.notes.append(warning)


def _begun_again(stamp: float) -> str:
    return f"the clock begins again at {stamp:.3f} s: what follows is mapped as if it came later"


def _clocks(sensor: Sensor, survey: Survey, spans: dict[str, tuple[float, float]]) -> str:
    """What to say where scans and poses have no time in common, though they were recorded together."""
    scans, poses = spans.get("scans"), spans.get("poses")
    if scans is None or poses is None or not sensor.seen.lags or not survey.lags:
        return ""
    apart = float(np.median(sensor.seen.lags) - np.median(survey.lags))
    if (scans[0] <= poses[1] and poses[0] <= scans[1]) or abs(apart) < TWO_CLOCKS:
        return ""
    return (
        "their stamps are of two clocks, which the times of recording bring together by "
        f"--time-offset {apart:.3f}"
    )
