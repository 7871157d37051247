# SPDX-License-Identifier: BSD-3-Clause
"""What is in a bag, for those who do not know it yet."""

from __future__ import annotations

from typing import Any

from ndtree.logs.ros.files.bag import Bag
from ndtree.logs.ros.messages.beams import CAMERA_INFO, SENSORS
from ndtree.logs.ros.sensors import encodings_in
from ndtree.logs.ros.survey import POSES, Survey


def outline(bag: Bag) -> dict[str, Any]:
    """Topics with their types, numbers and rates of messages and frames, when they were recorded, and /tf.

    Returns
    -------
    dict
        "start" and "end" [s]; "topics", each with "topic", "type", "messages", "frame", "rate" [Hz] and of
        images and of what cannot be read "encoding", None where it is not known; "frames", the lines of a
        tree; "damage", lines about files that are not whole.
    """
    framed = [one.name for one in bag.topics if one.messages and one.type in (*SENSORS, *POSES, CAMERA_INFO)]
    survey = Survey(bag, framed)
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
                "rate": None if seen is None else seen.rate,
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
