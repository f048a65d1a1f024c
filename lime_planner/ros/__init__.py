"""The ROS 2 side: messages to arrays and back, and the three nodes. The only part of the package that needs rclpy."""
