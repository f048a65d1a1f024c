"""The quality of service of every topic, by name, and subscriptions that follow what publishers offer."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(depth: int, reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)


#: Clouds and targets: nothing is lost on the way, only the newest counts.
NEWEST = _profile(1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
#: Clouds: as several cameras on one topic send them at the same moment.
CLOUDS = _profile(4, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
#: Joint states: best effort matches reliable publishers too.
JOINT_STATES = _profile(10, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
#: The motion command is never latched: a controller that starts later must not carry out an old motion.
COMMAND = _profile(1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
#: For subscribers that come later: status, path, markers, accepted target, robot description. One message: what comes first is the newest.
LATCHED = _profile(1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
#: How to subscribe to the status so that quick changes of phase all arrive; it is published as `LATCHED`.
EVERY_STATUS = _profile(10, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
#: Services: a burst of requests must not push out the ones not read yet.
SERVICE = _profile(1000, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


#: How long a subscription stays open to collect what a latching publisher had published before [s].
COLLECTING_S = 5.0


def is_best_effort(offer: QoSProfile) -> bool:
    """Tell whether a reliable subscription hears nothing of a publisher with this offer."""
    return bool(offer.reliability == ReliabilityPolicy.BEST_EFFORT)


def is_latched(offer: QoSProfile) -> bool:
    """Tell whether a publisher with this offer hands its last messages to a late subscription that asks for them."""
    return bool(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL and not is_best_effort(offer))


class AdaptiveSubscription:
    """A subscription that hears every publisher as well as it offers, by subscribing again under further profiles.

    The base profile, reliable and volatile, stays in any case. Best effort comes along while a publisher offers only that;
    transient local for a few seconds whenever a new publisher latches, to collect what a volatile subscription misses: every latching
    publisher hands over its last message then, and what is older than a message that is here already is history, not news. A message
    that arrives under two profiles is passed on once.

    Attributes:
        topic: its short name.
        lost: messages that were published and never got here, on the way or because newer ones came first; counted by the publisher's
            own numbers, while there is one publisher.
    """

    def __init__(self, node: Node, message_type: Any, topic: str, base: QoSProfile, callback: Callable[[Any], None]) -> None:
        """Subscribe with `base`.

        Args:
            node: the node, whose executor calls `check` and `callback` in one thread.
            message_type: the message class.
            topic: relative name, remapped as usual.
            base: reliable and volatile.
            callback: what to call with each message.
        """
        self._node = node
        self._type = message_type
        self.topic = topic
        self.lost = 0
        self._publishers: set[tuple[int, ...]] = set()
        self._last_number = 0  # 0: none to go by
        self._last_sent = 0
        self._callback = callback
        self._seen: deque[int] = deque(maxlen=16)
        self._collected: set[tuple[int, ...]] = set()
        self._collecting_since_s = 0.0
        self._best_effort = _profile(base.depth, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
        self._latched = _profile(base.depth, base.reliability, DurabilityPolicy.TRANSIENT_LOCAL)
        self._base = self._subscribe(base, self._receive)
        self._further: dict[str, Any] = {}

    def check(self) -> None:
        """Compare with the publishers' offers; to be called now and then (an event would only say that something changed)."""
        publishers = self._node.get_publishers_info_by_topic(self._base.topic_name)
        there = {tuple(info.endpoint_gid) for info in publishers}
        if there != self._publishers:
            if not there & self._publishers:
                self._last_sent = 0  # the publisher whose clock it was has gone
            self._publishers, self._last_number = there, 0
        self._keep("best effort", self._best_effort, any(is_best_effort(info.qos_profile) for info in publishers))
        latching = {tuple(info.endpoint_gid) for info in publishers if is_latched(info.qos_profile)}
        new = bool(latching - self._collected)
        now_s = time.monotonic()
        if new and "latched" not in self._further:
            self._collecting_since_s = now_s
        self._keep("latched", self._latched, new)
        if new and now_s - self._collecting_since_s >= COLLECTING_S:
            self._collected = latching

    def _keep(self, word: str, profile: QoSProfile, needed: bool) -> None:
        if needed and word not in self._further:
            self._node.get_logger().info(f"{self._base.topic_name}: subscribing as {word} too, which is what a publisher offers")
            self._further[word] = self._subscribe(profile, self._collect if word == "latched" else self._receive)
        elif not needed and word in self._further:
            self._node.destroy_subscription(self._further.pop(word))

    def _subscribe(self, profile: QoSProfile, callback: Callable[[Any, Mapping[str, Any]], None]) -> Any:
        # Our own handler keeps rclpy from logging a warning for an offer that `check` is about to follow.
        events = SubscriptionEventCallbacks(incompatible_qos=lambda _event: None)
        return self._node.create_subscription(self._type, self.topic, callback, profile, event_callbacks=events)

    def _collect(self, msg: Any, info: Mapping[str, Any]) -> None:
        if int(info.get("source_timestamp") or 0) >= self._last_sent:
            self._receive(msg, info)

    def _receive(self, msg: Any, info: Mapping[str, Any]) -> None:
        sent = int(info.get("source_timestamp") or 0)
        if sent and sent in self._seen:
            return
        self._seen.append(sent)
        number = int(info.get("publication_sequence_number") or 0)
        if len(self._publishers) == 1 and 0 < number < self._last_number and 0 < sent < self._last_sent:
            return  # under one profile the next message came first: this one must not take its place
        self._last_sent = max(self._last_sent, sent)
        self._count(number)
        self._callback(msg)

    def _count(self, number: int) -> None:
        if len(self._publishers) != 1:
            return
        if 0 < self._last_number < number - 1:
            self.lost += number - 1 - self._last_number
        self._last_number = max(self._last_number, number)
