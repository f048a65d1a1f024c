"""From a path to a motion command: timing, the rules of a trajectory message, replay by the controllers, stopping."""
