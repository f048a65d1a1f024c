"""The search, which knows neither ROS nor clouds: spaces that it can run on, and the planners."""
