# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2, read without ROS: scans of their sensors, each with the pose of its time."""

from __future__ import annotations

import heapq
import os
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from itertools import islice
from operator import attrgetter
from typing import Any

from ndtree.base.scan import Scan
from ndtree.logs.core.failures import NoPose
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.rules import Rules
from ndtree.logs.core.source import Format, Source
from ndtree.logs.ros.clock import by_stamp
from ndtree.logs.ros.files.bag import ENDINGS, MAGICS, METADATA, METADATA_BEGINS, ZSTD_MAGIC, Bag, open_bag
from ndtree.logs.ros.messages.beams import CAMERA_INFO, IMAGES, SENSORS
from ndtree.logs.ros.options import BagOptions
from ndtree.logs.ros.plan import planned
from ndtree.logs.ros.reading import MessageReader, OtherFrame
from ndtree.logs.ros.sensors import encodings_in
from ndtree.logs.ros.storage import OnDamage, Raw
from ndtree.logs.ros.survey import POSES, TF, Survey


class RosbagLog(SizedLog):
    """The messages of one or more sensor topics with their poses.

    Transforms, poses, cameras and the times of all scans are read when the log is opened, measurements while
    it is iterated. The length is the topics' number of messages. With `bag`, messages in memory are read
    instead of the files at `path`, which is then a name for errors; `so_far` more of them may follow.

    `plan`: What was decided when it was opened.
    `fixed_frame`: Of the map.
    """

    format = "rosbag"
    path: str

    def __init__(
        self,
        path: str,
        options: BagOptions | None = None,
        *,
        dim: int | None = None,
        bag: Bag | None = None,
        so_far: bool = False,
    ) -> None:
        options = options or BagOptions()
        options.check(path)
        self.path, self._in_memory = path, bag
        with self._opened() as opened:
            self.plan = plan = planned(opened, options, dim, so_far=so_far, in_memory=bag is not None)
        super().__init__(path, dim=plan.dim)
        self.sensors, self.fixed_frame = plan.sensors, plan.place.fixed_frame
        self.sensors_read = len(self.sensors)
        cameras = [sensor.camera_topic for sensor in self.sensors if sensor.camera_topic]
        self.uses = (
            " and ".join(sensor.description for sensor in self.sensors)
            + (f", cameras from {' and '.join(cameras)}" if cameras else "")
            + (", " if options.still else f", poses in {self.fixed_frame} from ")
            + plan.place.origin
        )
        self.rules = Rules(zero_is=options.zero_is)
        self.may_be_zero = self.knows_no_returns = any(sensor.is_planar for sensor in self.sensors)
        self.is_depth_camera = all(sensor.topic.type in IMAGES for sensor in self.sensors)
        self.hint, self._decided = plan.hint, list(plan.notes)

    def __len__(self) -> int:
        return sum(sensor.topic.messages for sensor in self.sensors)

    decisions = property(attrgetter("plan.decisions"))
    spans = property(attrgetter("plan.spans"))
    place = property(attrgetter("plan.place"))  # How the first sensor's poses are found.

    def _opened(self) -> AbstractContextManager[Bag]:
        return open_bag(self.path) if self._in_memory is None else nullcontext(self._in_memory)

    def _scans(self) -> Iterator[Scan]:
        for damage in self.plan.damage if self.rules.strict else ():
            raise ValueError(f"{damage}, expected a whole bag")
        for error in self.plan.damaged:
            self.skip("damaged messages", error)
        with self._opened() as bag:
            reader = MessageReader(bag, self.plan, self.rules)
            try:
                yield from self._read(bag, reader)
            finally:
                self._seen += reader.notes()

    def _read(self, bag: Bag, reader: MessageReader) -> Iterator[Scan]:
        topics = [sensor.topic.name for sensor in self.sensors]
        messages = bag.messages(topics, on_damage=lambda error: self.skip("damaged bags", error))
        if len(topics) > 1:
            messages = by_stamp(messages, self.plan.clock)
        for raw in messages:
            nothing = self._passed_over()
            if nothing is not None:
                reader.pass_over(raw)
                yield nothing
                continue
            try:
                measured = reader.measured(raw)
            except OtherFrame as error:
                self._leave_out("messages in other frames", error, error.of_all)
                continue
            except ValueError as error:
                self.skip("damaged messages", error)
                continue
            try:
                scan = reader.scan(measured)
            except NoPose as error:
                self._leave_out_unposed(error)
                continue
            self.zeros, self.sensor = reader.zeros, f"{measured.topic} in {measured.frame}"
            yield scan


def _recognises(source: Source) -> bool:
    if source.is_folder:
        return METADATA in source.names or any(name.endswith(ENDINGS) for name in source.names)
    if source.head.startswith(ZSTD_MAGIC):  # What is in it, its name says.
        return source.path.endswith(ENDINGS)
    return source.head.startswith((*MAGICS, METADATA_BEGINS))


def _bag_of(source: Source) -> str:
    """The path of the bag: of its metadata.yaml, the folder."""
    return os.path.dirname(source.path) or "." if source.head.startswith(METADATA_BEGINS) else source.path


def _open(source: Source, *, dim: int | None = None, **options: Any) -> RosbagLog:
    return RosbagLog(_bag_of(source), BagOptions(**options), dim=dim)


def _contents(source: Source, whole: bool = True) -> dict[str, Any]:
    with open_bag(_bag_of(source)) as bag:
        return outline(bag, whole=whole)


ROSBAG = Format(
    "rosbag",
    "a ROS bag",
    _recognises,
    _open,
    options=tuple(one.name for one in fields(BagOptions)),
    stored_as="either",
    contents=_contents,
    dim=None,
)  # fmt: skip


#: Number of transforms that are looked at, where not all are.
_TRANSFORMS = 400


class _Beginnings(Bag):
    """A bag's first message of each topic, and its first transforms: enough to say what frames there are."""

    def __init__(self, bag: Bag) -> None:
        self.__dict__.update(bag.__dict__)

    def messages(self, topics: Collection[str], on_damage: OnDamage | None = None) -> Iterator[Raw]:
        most = dict.fromkeys((topic.name for topic in self.of_type(*TF)), _TRANSFORMS)
        rows = [
            list(islice(super(_Beginnings, self).messages([name], on_damage), most.get(name, 1)))
            for name in sorted(topics)
        ]
        return heapq.merge(*rows, key=lambda raw: raw.received)


def outline(bag: Bag, *, whole: bool = True) -> dict[str, Any]:
    """Topics with their types, numbers and rates of messages and frames, when they were recorded, and /tf.

    `whole`: Read all of it. Else what its index says, and the first messages: frames that appear later are
        missing, and rates are not known.
    Returns: "start" and "end" [s]; "topics", each with "topic", "type", "messages", "frame", "rate" [Hz] and
    of images and of what cannot be read "encoding", None where it is not known; "frames", the lines of a
    tree; "damage", lines about files that are not whole.
    """
    framed = [one.name for one in bag.topics if one.messages and one.type in (*SENSORS, *POSES, CAMERA_INFO)]
    survey = Survey(bag if whole else _Beginnings(bag), framed)
    topics = []
    encodings = encodings_in(bag)
    for topic in bag.topics:
        seen = survey.seen.get(topic.name)
        infos = survey.infos.get(topic.name)
        frame = seen.frame if seen is not None and seen.frames else None
        if infos:
            frame = infos[0][1].header.frame_id.lstrip("/")
        rate = seen.rate if seen is not None and whole else None
        about = {"frame": frame, "rate": rate, "encoding": encodings.get(topic.name)}
        topics.append({"topic": topic.name, "type": topic.type, "messages": topic.messages, **about})
    for topic, packing in bag.unread:
        about = {"messages": topic.messages, "frame": None, "rate": None, "encoding": packing}
        topics.append({"topic": topic.name, "type": topic.type, **about})
    when = {"start": bag.start, "end": bag.end}
    return {**when, "topics": topics, "frames": survey.tree.lines(), "damage": bag.damage}
