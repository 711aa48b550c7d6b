"""What the world does: hand, instrument, sensors and actuators, as models of their own."""
