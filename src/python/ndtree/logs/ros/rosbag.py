# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2, read without ROS: scans of their sensors, each with the pose of its time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from ndtree.base.scan import Scan
from ndtree.logs.core.failures import NoPose
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.source import WrongOption
from ndtree.logs.core.zeros import checked
from ndtree.logs.folders.depth_image import check_stride
from ndtree.logs.poses.covariances import AUTO, REMEMBERED, USE, USES, PoseCovariances
from ndtree.logs.ros.choice import in_order as in_order_of_sight
from ndtree.logs.ros.choice import poor, sights
from ndtree.logs.ros.files.bag import Bag, open_bag
from ndtree.logs.ros.merging import in_order
from ndtree.logs.ros.messages.beams import IMAGES
from ndtree.logs.ros.messages.sweep import BY_WORD
from ndtree.logs.ros.placement.advice import without_sensors
from ndtree.logs.ros.placement.body import Body
from ndtree.logs.ros.placement.level import dimension_of
from ndtree.logs.ros.placement.placement import Asked, Placement
from ndtree.logs.ros.placement.placing import find_places, poses_topic
from ndtree.logs.ros.reading import MessageReader, OtherFrame, elsewhere_said
from ndtree.logs.ros.sensors import Sensor, Wanted, chosen, encodings_in, listed, readable
from ndtree.logs.ros.survey import Survey
from ndtree.logs.ros.sweep_choice import understood

#: Stamps and poses that are further apart are of two clocks [s].
TWO_CLOCKS = 1.0


class RosbagLog(SizedLog):
    """The messages of one or more sensor topics with their poses.

    Transforms, poses, cameras and the times of all scans are read when the log is opened, measurements while
    it is iterated. The length is the topics' number of messages. With `bag`, messages in memory are read
    instead of the files at `path`, which is then a name for errors; `so_far` more of them may follow.

    Attributes
    ----------
    sensors : list of Sensor
    places : dict of str to Placement
        By topic, how its poses are found.
    sweeps : dict of str to Sweep
        By topic, what the times of beams mean.
    fixed_frame : str
        Of the map.
    time_offset : float
        Added to the stamps of scans [s].
    clock : Clock
    covariances : PoseCovariances
        Of the topic of the first sensor's poses.
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
        sweep: str | None = None,
        camera: str | None = None,
        pixel_stride: int = 1,
        zero_is: str | None = None,
        body: str | None = None,
        pose_covariance: str | None = None,
        bag: Bag | None = None,
        so_far: bool = False,
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
        if sweep is not None and sweep not in BY_WORD:
            raise WrongOption(f"{path}: sweep = {sweep}: expected one of {', '.join(BY_WORD)}")
        if sweep is not None and not deskew:
            raise WrongOption(f"{path}: sweep = {sweep}: is for beams that are deskewed")
        if pose_covariance is not None and pose_covariance not in USES:
            raise WrongOption(
                f"{path}: pose_covariance = {pose_covariance}: expected one of {', '.join(USES)}"
            )
        check_stride(pixel_stride)
        checked(path, zero_is)
        try:
            self._body = None if body is None else Body.of(body)
        except ValueError as error:
            raise WrongOption(f"{path}: {error}") from None
        wanted = [Wanted.of(one) for one in ([topic] if isinstance(topic, str) else topic or [])]
        self.time_offset = float(time_offset)
        self._in_memory = bag
        self.path = path
        with self._opened() as bag:
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
            survey, self.places = found.survey, found.places
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
            self.sweeps, said = understood(
                bag,
                self.sensors,
                self.places,
                self.clock,
                self.time_offset,
                deskew,
                sweep,
                so_far=so_far,
            )
        self._bodies = {
            name: self._body.frame_of(place, base_frame)
            for name, place in (self.places.items() if self._body is not None else ())
        }
        first = self.places[self.sensors[0].topic.name]
        self.fixed_frame = first.fixed_frame
        cameras = [sensor.camera_topic for sensor in self.sensors if sensor.camera_topic]
        self.uses = (
            " and ".join(sensor.description for sensor in self.sensors)
            + (f", cameras from {' and '.join(cameras)}" if cameras else "")
            + (", " if still else f", poses in {self.fixed_frame} from ")
            + first.origin
        )
        super().__init__(path, dim=dimension_of(path, self.sensors, self.places, dim))
        self.zero_is = zero_is
        self.may_be_zero = any(sensor.is_planar for sensor in self.sensors)
        self.is_depth_camera = all(sensor.topic.type in IMAGES for sensor in self.sensors)
        self.knows_no_returns = any(sensor.is_planar for sensor in self.sensors)
        self.covariances = self._covariances_of(survey, pose_covariance or AUTO)
        self._elsewhere = {one.topic.name: self._unplaced(one, asked) for one in self.sensors}
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
        return self.places[self.sensors[0].topic.name]

    def _unplaced(self, sensor: Sensor, asked: Asked) -> list[str]:
        """Frames of some of a topic's messages without a pose."""
        place, others = self.places[sensor.topic.name], sensor.seen.frames.keys() - {sensor.seen.frame}
        if asked.sensor_frame is not None:  # Whatever the messages say.
            return []
        known = place.tree.connected(place.fixed_frame) if place.is_own else []
        return sorted(others - set(known))

    def _covariances_of(self, survey: Survey, use: str) -> PoseCovariances:
        """Those of the topic that the poses of the first sensor are of."""
        most = None if self._in_memory is None else REMEMBERED
        covariances = PoseCovariances(self.place.origin, use, self.dim, most)
        for row in survey.poses:
            covariances.add(row.stamp, row.covariance)
        if use == USE and not covariances.are_used and self._in_memory is None:
            raise WrongOption(
                f"{self.path}: pose_covariance = {use}: the poses of {self.place.origin} have no covariance, "
                "expected --odometry or --poses with a topic whose poses have some"
            )
        return covariances

    def _opened(self) -> AbstractContextManager[Bag]:
        """The bag, open for as long as it is read."""
        return open_bag(self.path) if self._in_memory is None else nullcontext(self._in_memory)

    def reader(self, bag: Bag) -> MessageReader:
        """What makes scans of the messages of the log's sensors, which `bag` decodes."""
        return MessageReader(
            bag,
            self.sensors,
            self.places,
            self.sweeps,
            self._elsewhere,
            clock=self.clock,
            time_offset=self.time_offset,
            dim=self.dim,
            no_return_range=self.no_return_range,
            zero_is=self.zero_is,
            body=self._body,
            bodies=self._bodies,
            covariances=self.covariances,
        )

    def _scans(self) -> Iterator[Scan]:
        del self.notes[self.fixed_note :]
        for damage in self._damage if self.strict else ():
            raise ValueError(f"{damage}, expected a whole bag")
        for error in self._damaged:
            self._skip("damaged messages", error)
        with self._opened() as bag:
            reader = self.reader(bag)
            try:
                yield from self._read(bag, reader)
            finally:
                self.notes += reader.notes()

    def _read(self, bag: Bag, reader: MessageReader) -> Iterator[Scan]:
        topics = [sensor.topic.name for sensor in self.sensors]
        messages = bag.messages(topics, on_damage=lambda error: self._skip("damaged bags", error))
        if len(topics) > 1:
            messages = in_order(messages, self.clock)
        for raw in messages:
            try:
                measured = reader.measured(raw)
            except OtherFrame as error:
                others = self._elsewhere[error.sensor.topic.name]
                self._leave_out("messages in other frames", error, elsewhere_said(error.sensor, others))
                continue
            except ValueError as error:
                self._skip("damaged messages", error)
                continue
            try:
                scan = reader.scan(measured)
            except NoPose as error:
                self._leave_out_unposed(error)
                continue
            self.zeros = reader.zeros
            yield scan


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
