"""Spins a client's node in a thread of its own, until it is closed."""

from __future__ import annotations

import threading

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future


class Spinning:
    """The node, its executor and their thread; `close` takes all of them, and the node's context, down."""

    def __init__(self, node: Node) -> None:
        """Start to spin; the node is complete."""
        self.node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._done = Future()
        self._thread = threading.Thread(target=self._executor.spin_until_future_complete, args=(self._done,), name="spin", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._done.set_result(None)
        self._executor.wake()
        self._thread.join(5.0)
        self._executor.shutdown()
        context = self.node.context
        self.node.destroy_node()
        context.try_shutdown()
