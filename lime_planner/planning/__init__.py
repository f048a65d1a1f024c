"""The search, which knows neither ROS nor clouds: spaces it can run on, the potential field, the tree and the planners."""
