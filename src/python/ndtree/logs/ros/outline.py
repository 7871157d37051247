# SPDX-License-Identifier: BSD-3-Clause
"""What is in a bag, for those who do not know it yet."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator
from itertools import islice
from typing import Any

from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages.beams import CAMERA_INFO, SENSORS
from ndtree.logs.ros.sensors import encodings_in
from ndtree.logs.ros.storage import OnDamage, Raw
from ndtree.logs.ros.survey import POSES, TF, Survey

#: Number of transforms that are looked at, where not all are.
_TRANSFORMS = 400


class _Beginnings:
    """A bag's first message of each topic, and its first transforms: enough to say what frames there are."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag

    def of_type(self, *types: str) -> list[Topic]:
        return self._bag.of_type(*types)

    def messages(
        self, topics: Collection[str], *, heads: Collection[str] = (), on_damage: OnDamage | None = None
    ) -> Iterator[Raw]:
        moving = {topic.name for topic in self._bag.of_type(*TF)}

        def first(name: str) -> list[Raw]:
            most = _TRANSFORMS if name in moving else 1
            whole, beginning = ([name], []) if name in topics else ([], [name])
            return list(islice(self._bag.messages(whole, heads=beginning, on_damage=on_damage), most))

        rows = [first(name) for name in sorted({*topics, *heads})]
        return heapq.merge(*rows, key=lambda raw: raw.received)

    def named(self, raw: Raw) -> Any:
        return self._bag.named(raw)


def outline(bag: Bag, *, whole: bool = True) -> dict[str, Any]:
    """Topics with their types, numbers and rates of messages and frames, when they were recorded, and /tf.

    `whole`: Read all of it. Else what its index says, and the first messages: frames that appear later are
        missing, and rates are over all of the recording.
    Returns: "start" and "end" [s]; "topics", each with "topic", "type", "messages", "frame", "rate" [Hz] and
    of images and of what cannot be read "encoding", None where it is not known; "frames", the lines of a
    tree; "damage", lines about files that are not whole.
    """
    framed = [one.name for one in bag.topics if one.messages and one.type in (*SENSORS, *POSES, CAMERA_INFO)]
    survey = Survey(bag if whole else _Beginnings(bag), framed)  # type: ignore[arg-type]
    span = bag.end - bag.start
    topics = []
    encodings = encodings_in(bag)
    for topic in bag.topics:
        seen = survey.seen.get(topic.name)
        infos = survey.infos.get(topic.name)
        frame = seen.frame if seen is not None and seen.frames else None
        if infos:
            frame = infos[0][1].header.frame_id.lstrip("/")
        topics.append(
            {
                "topic": topic.name,
                "type": topic.type,
                "messages": topic.messages,
                "frame": frame,
                "rate": _rate(topic, span) if not whole else None if seen is None else seen.rate,
                "encoding": encodings.get(topic.name),
            }
        )
    for topic, packing in bag.unread:
        about = {"messages": topic.messages, "frame": None, "rate": None, "encoding": packing}
        topics.append({"topic": topic.name, "type": topic.type, **about})
    return {
        "start": bag.start,
        "end": bag.end,
        "topics": topics,
        "frames": survey.tree.lines(),
        "damage": bag.damage,
    }


def _rate(topic: Topic, span: float) -> float | None:
    """Messages in a second of a recording; None of one or none, and of what is said once."""
    is_once = topic.messages < 2 or topic.name.endswith("tf_static")
    return None if is_once or span <= 0 else (topic.messages - 1) / span
