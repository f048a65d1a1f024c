"""The quality of service of every topic, by name, and subscriptions that follow what publishers offer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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


def matching_profile(base: QoSProfile, offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return `base`, weakened or latched to suit what publishers offer.

    Best effort where any publisher offers only that (a reliable subscription would hear nothing from it); transient local where
    every publisher offers it (a volatile subscription would miss what was published before).
    """
    if not offers:
        return base
    best_effort = any(offer.reliability == ReliabilityPolicy.BEST_EFFORT for offer in offers)
    latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers) and not best_effort
    return _profile(
        base.depth,
        ReliabilityPolicy.BEST_EFFORT if best_effort else base.reliability,
        DurabilityPolicy.TRANSIENT_LOCAL if latched else base.durability,
    )


class AdaptiveSubscription:
    """A subscription that subscribes again when the publishers' offer asks for it."""

    def __init__(self, node: Node, message_type: Any, topic: str, base: QoSProfile, callback: Callable[[Any], None]) -> None:
        """Subscribe with `base`.

        Args:
            node: the node, whose executor calls `check` and `callback` in one thread.
            message_type: the message class.
            topic: relative name, remapped as usual.
            base: the wish, kept where the publishers allow it.
            callback: what to call with each message.
        """
        self._node = node
        self._type = message_type
        self._topic = topic
        self._base = base
        self._callback = callback
        self._profile = base
        self._due = False
        self._subscription = self._subscribe()

    @property
    def reliability(self) -> str:
        """`reliable` or `best_effort`, as subscribed now."""
        return str(self._profile.reliability.name).lower()

    @property
    def publishers(self) -> int:
        """Number of matching publishers in the graph."""
        return int(self._node.count_publishers(self._subscription.topic_name))

    def check(self) -> None:
        """Compare with the publishers' offers; to be called now and then (an event only says that something changed)."""
        offers = [info.qos_profile for info in self._node.get_publishers_info_by_topic(self._subscription.topic_name)]
        wanted = matching_profile(self._base, offers)
        if (wanted.reliability, wanted.durability) == (self._profile.reliability, self._profile.durability):
            return
        self._node.get_logger().info(
            f"{self._subscription.topic_name}: subscribing again as {wanted.reliability.name.lower()}, "
            f"{wanted.durability.name.lower()}, which is what its {len(offers)} publisher(s) offer"
        )
        self._profile = wanted
        old, self._subscription = self._subscription, self._subscribe()
        self._node.destroy_subscription(old)

    def _subscribe(self) -> Any:
        # Our own handler keeps rclpy from logging a warning for an offer that `check` is about to follow.
        events = SubscriptionEventCallbacks(incompatible_qos=lambda _event: None)
        return self._node.create_subscription(self._type, self._topic, self._callback, self._profile, event_callbacks=events)
