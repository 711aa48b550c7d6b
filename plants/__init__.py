"""Models of the world: hand, instrument, sensors and actuators."""
