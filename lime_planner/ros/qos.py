"""The quality of service of every topic, by name, and subscriptions that follow what publishers offer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(depth: int, reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)


#: Clouds and targets: nothing is lost on the way, only the newest counts.
NEWEST = _profile(1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
#: Joint states: best effort matches reliable publishers too.
JOINT_STATES = _profile(10, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
#: The motion command is never latched: a controller that starts later must not carry out an old motion.
COMMAND = _profile(1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
#: For whoever comes later: path, markers, accepted target, robot description.
LATCHED = _profile(1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
#: Status: latched, and deep enough that quick changes of phase all arrive.
STATUS = _profile(10, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
#: Services: a burst of requests must not push out the ones not read yet.
SERVICE = _profile(1000, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def needed_profiles(base: QoSProfile, offers: Sequence[QoSProfile]) -> list[QoSProfile]:
    """Return the profiles under which one must subscribe to hear every publisher as well as it offers.

    `base` always. Best effort too where a publisher offers only that (a reliable subscription hears nothing from it); transient
    local too where a publisher latches (a volatile subscription misses what was published before).

    Args:
        base: reliable and volatile.
        offers: the publishers' profiles.
    """
    needed = [base]
    reliable = [offer for offer in offers if offer.reliability != ReliabilityPolicy.BEST_EFFORT]
    if any(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in reliable):
        needed.append(_profile(base.depth, base.reliability, DurabilityPolicy.TRANSIENT_LOCAL))
    if len(reliable) < len(offers):
        needed.append(_profile(base.depth, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE))
    return needed


class AdaptiveSubscription:
    """A subscription that follows what the publishers offer, by subscribing again under further profiles.

    A message that arrives under two of them is passed on once.
    """

    def __init__(self, node: Node, message_type: Any, topic: str, base: QoSProfile, callback: Callable[[Any], None]) -> None:
        """Subscribe with `base`.

        Args:
            node: the node, whose executor calls `check` and `callback` in one thread.
            message_type: the message class.
            topic: relative name, remapped as usual.
            base: reliable and volatile, kept in any case.
            callback: what to call with each message.
        """
        self._node = node
        self._type = message_type
        self._topic = topic
        self._base = base
        self._callback = callback
        self._seen: deque[int] = deque(maxlen=16)
        self._subscriptions = {_key(base): self._subscribe(base)}

    def check(self) -> None:
        """Compare with the publishers' offers; to be called now and then (an event would only say that something changed)."""
        name = self._subscriptions[_key(self._base)].topic_name
        offers = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
        if not offers:
            return
        needed = {_key(profile): profile for profile in needed_profiles(self._base, offers)}
        for key in [key for key in self._subscriptions if key not in needed]:
            self._node.destroy_subscription(self._subscriptions.pop(key))
        for key, profile in needed.items():
            if key not in self._subscriptions:
                words = f"{profile.reliability.name}, {profile.durability.name}".lower()
                self._node.get_logger().info(f"{name}: subscribing as {words} too, which is what a publisher offers")
                self._subscriptions[key] = self._subscribe(profile)

    def _subscribe(self, profile: QoSProfile) -> Any:
        # Our own handler keeps rclpy from logging a warning for an offer that `check` is about to follow.
        events = SubscriptionEventCallbacks(incompatible_qos=lambda _event: None)
        return self._node.create_subscription(self._type, self._topic, self._receive, profile, event_callbacks=events)

    def _receive(self, msg: Any, info: Mapping[str, Any]) -> None:
        sent = int(info.get("source_timestamp") or 0)
        if sent and sent in self._seen:
            return
        self._seen.append(sent)
        self._callback(msg)


def _key(profile: QoSProfile) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
    return profile.reliability, profile.durability
